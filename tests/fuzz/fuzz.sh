#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# Gives each fuzz target so many runs under AddressSanitizer and UBSan, and then prints which share
# of the lines that it is about they reached.
#     fuzz.sh FOLDER RUNS [TARGET...]
# With clang and its libFuzzer (Debian: clang, libclang-rt-14-dev) inputs follow the coverage; without,
# the driver beside this file makes them. FOLDER keeps what was built, the inputs that libFuzzer found
# worth keeping, and a crash's input. Exit 0: nothing was found.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
out=$1 runs=$2
shift 2
mkdir -p "$out"
cd "$root"

core=$(ls pipeline/core/*.c | grep -v sandbox)
acquire=$(ls acquire/*.c)
flags="-std=gnu17 -D_GNU_SOURCE -DGSN_VERSION=\"fuzz\" -DGSN_LIBEXECDIR=\"/\" -I. -g $(pkg-config --cflags libusb-1.0 jansson gsl)"
libraries="$(pkg-config --libs libusb-1.0 jansson zlib libcrypto gsl) -lm -lpthread"
sanitizers="-fsanitize=address,undefined -fno-sanitize-recover=all"
# No run lives long: a small quarantine keeps freed memory from being new pages each time, which took
# a tenth of the time.
export ASAN_OPTIONS=abort_on_error=1:quarantine_size_mb=8

# What is judged, and what that needs besides.
sources_of() {
    case $1 in
    container) echo "acquire/container.c" ;;
    uvc) echo "acquire/uvc.c" ;;
    ptp) ls acquire/ptp_*.c | grep -v ptp_transport ;;
    volume) ls pipeline/decode/volume*.c ;;
    job) echo "pipeline/specimen/protocol.c" ;;
    esac
}
needs_of() {
    case $1 in
    container | uvc) ls acquire/*.c ;;
    ptp) ls acquire/*.c tests/device/memory_transport.c tests/device/ptp_model.c tests/device/ptp_answers.c \
        tests/device/blob.c tests/device/usb_standard.c ;;
    volume) sources_of volume ;;
    job) echo "pipeline/core/calendar.c pipeline/stain/tissue_segmentation.c pipeline/imaging/threshold.c" && sources_of job ;;
    esac
}

if echo 'int LLVMFuzzerTestOneInput(const char *b, unsigned long n) { return b && n > 9; }' |
    clang -x c -fsanitize=fuzzer - -o "$out/probe" 2>/dev/null; then
    engine=libFuzzer
else
    engine=driver
fi

for target in ${*:-container volume job ptp uvc}; do
    corpus="$here/corpus/$target" grown="$out/grown-$target"
    rm -rf "$grown" && mkdir "$grown"
    # shellcheck disable=SC2046,SC2086
    if [ $engine = libFuzzer ]; then
        clang $flags -O2 $sanitizers -fsanitize=fuzzer "$here/fuzz_$target.c" $(needs_of $target) $core \
            -o "$out/fuzz_$target" $libraries
        "$out/fuzz_$target" -runs="$runs" -seed=1 -max_len=4096 -timeout=20 -print_final_stats=1 \
            -artifact_prefix="$out/" "$grown" "$corpus" >"$out/$target.log" 2>&1 || {
            tail -n 40 "$out/$target.log"
            exit 1
        }
        grep -E "cov: " "$out/$target.log" | tail -n 1 | sed "s/^/$target: /"
    else
        gcc $flags -O2 $sanitizers "$here/fuzz_$target.c" "$here/driver.c" $(needs_of $target) $core \
            -o "$out/fuzz_$target" $libraries
        "$out/fuzz_$target" -runs="$runs" "$corpus"
    fi
    # What the corpus and what grew out of it reach, line by line.
    rm -rf "$out/cover-$target" && mkdir "$out/cover-$target"
    parts=$(for file in $(needs_of "$target") $core; do echo "$root/$file"; done)
    judged=$(sources_of "$target")
    # shellcheck disable=SC2046,SC2086
    (cd "$out/cover-$target" && gcc $flags -I"$root" -O0 --coverage "$here/fuzz_$target.c" "$here/driver.c" \
        $parts -o cover $libraries && ./cover "$corpus" $(find "$grown" -type f) >/dev/null &&
        for file in $judged; do
            gcov -n "cover-$(basename "$file" .c).gcda" 2>/dev/null |
                grep -A1 "File '$root/$file'" | sed -n "s|^Lines executed:|$target: $file |p"
        done)
    echo "$target: $runs runs by $engine, nothing found"
done
