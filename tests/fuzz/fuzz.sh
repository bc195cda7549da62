#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# Gives each fuzz target so many runs under AddressSanitizer and UBSan, and then prints which share
# of the lines that it is about they reached.
#     fuzz.sh FOLDER RUNS [TARGET...]
# With clang and its libFuzzer (Debian: clang, libclang-rt-14-dev) inputs follow the coverage; without,
# the driver beside this file makes them. CMake builds what a target needs, as it does for the tests.
# FOLDER keeps what was built, the inputs that libFuzzer found worth keeping, and a crash's input.
# Exit 0: nothing was found.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
mkdir -p "$1"
out=$(cd "$1" && pwd) runs=$2
shift 2

# No run lives long: a small quarantine keeps freed memory from being new pages each time, which took
# a tenth of the time.
export ASAN_OPTIONS=abort_on_error=1:quarantine_size_mb=8

# The files that a target judges.
sources_of() {
    case $1 in
    container) echo "acquire/container.c" ;;
    uvc) echo "acquire/uvc.c" ;;
    ptp) (cd "$root" && ls acquire/ptp_*.c | grep -v ptp_transport) ;;
    volume) (cd "$root" && ls pipeline/decode/volume*.c) ;;
    job) echo "pipeline/specimen/protocol.c" ;;
    imagej_roi) echo "pipeline/specimen/imagej_roi.c" ;;
    esac
}

# configure FOLDER FLAGS [OPTION...]
configure() {
    folder=$1 flags=$2
    shift 2
    cmake -S "$root" -B "$folder" -DBUILD_TESTING=ON -DCMAKE_BUILD_TYPE=Debug \
        -DCMAKE_C_FLAGS="$flags" -DCMAKE_CXX_FLAGS="$flags" "$@" >"$folder.log" 2>&1 || {
        tail -n 40 "$folder.log"
        exit 1
    }
}

# build FOLDER TARGET
build() {
    cmake --build "$1" --parallel "$(nproc)" --target "$2" >"$1.log" 2>&1 || {
        tail -n 40 "$1.log"
        exit 1
    }
}

sanitizers="-O2 -fsanitize=address,undefined -fno-sanitize-recover=all"
if echo 'int LLVMFuzzerTestOneInput(const char *b, unsigned long n) { return b && n > 9; }' |
    clang -x c -fsanitize=fuzzer - -o "$out/probe" 2>/dev/null; then
    engine=libFuzzer
    # Warnings are gcc's matter here.
    configure "$out/build" "$sanitizers -fsanitize=fuzzer-no-link -w" -DCMAKE_C_COMPILER=clang \
        -DCMAKE_CXX_COMPILER=clang++ -DGSN_LIBFUZZER=ON
else
    engine=driver
    configure "$out/build" "$sanitizers"
fi
configure "$out/cover" "-O0 --coverage -w"

for target in ${*:-container volume job ptp uvc imagej_roi}; do
    corpus="$here/corpus/$target" grown="$out/grown-$target"
    rm -rf "$grown" && mkdir "$grown"
    build "$out/build" "fuzz_$target"
    if [ $engine = libFuzzer ]; then
        "$out/build/tests/fuzz_$target" -runs="$runs" -seed=1 -max_len=4096 -timeout=20 -print_final_stats=1 \
            -artifact_prefix="$out/" "$grown" "$corpus" >"$out/$target.log" 2>&1 || {
            tail -n 40 "$out/$target.log"
            exit 1
        }
        grep -E "cov: " "$out/$target.log" | tail -n 1 | sed "s/^/$target: /"
    else
        "$out/build/tests/fuzz_$target" -runs="$runs" "$corpus"
    fi
    # What the corpus and what grew out of it reach, line by line.
    build "$out/cover" "fuzz_$target"
    find "$out/cover" -name '*.gcda' -delete
    # shellcheck disable=SC2046
    "$out/cover/tests/fuzz_$target" "$corpus" $(find "$grown" -type f) >/dev/null
    for file in $(sources_of "$target"); do
        gcov -n "$(find "$out/cover" -path "*/$(basename "$(dirname "$file")")/*" -name "$(basename "$file").gcda")" 2>/dev/null |
            grep -A1 "File '$root/$file'" | sed -n "s|^Lines executed:|$target: $file |p"
    done
    echo "$target: $runs runs by $engine, nothing found"
done
