#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# libgieson-spline as another program's author has it: installed somewhere, found by pkg-config.
#     library.sh BUILD SOURCES COMPILER MESHER FLAGS WHAT
# exports:  the library shows what its headers declare, and nothing else
# examples: those of docs/examples are built, run, and find what they look for
# page:     so are the programs of docs/user/library.md, with the commands it gives
set -eu
build=$1 sources=$2 cc=$3 mesher=$4 flags=$5 what=$6
for tool in pkg-config nm readelf; do
    command -v $tool >/dev/null || {
        echo "skipped: $tool is not installed"
        exit 77
    }
done
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cmake --install "$build" --component spline --prefix "$work/usr" >/dev/null
library=$(dirname "$(find "$work/usr" -name 'libgieson-spline.so')")
export PKG_CONFIG_PATH="$library/pkgconfig" LD_LIBRARY_PATH="$library"
linked=$(pkg-config --define-variable=prefix="$work/usr" --cflags --libs gieson-spline)
status=0
wrong() {
    echo "wrong: $*"
    status=1
}

exports() {
    headers="$work/usr/include/gieson-spline"
    # Comments go, then every name of ours in front of a parenthesis.
    find "$headers" -name '*.h' -exec cat {} + | tr '\n' ' ' | sed 's|/\*|\n&|g; s|\*/|&\n|g' |
        sed '/^\/\*.*\*\/$/d' | grep -o 'gsn_[a-z_]*(' | tr -d '(' | grep -v '^gsn_progress_say$' |
        sort -u >"$work/declared"
    nm -D --defined-only "$library/libgieson-spline.so" | awk '$2 == "T" { print $3 }' |
        sed 's/@.*//' | sort >"$work/shown"
    diff "$work/declared" "$work/shown" || wrong "declared (<) is not what is shown (>)"
    readelf -d "$library/libgieson-spline.so" >"$work/dynamic"
    grep -q 'soname: \[libgieson-spline\.so\.[0-9]*\]' "$work/dynamic" || wrong "the soname"
    ! grep -E 'lib(tet|opencv|tiff|sqlite|seccomp)' "$work/dynamic" || wrong "it needs too much"
    echo '#include <gieson-spline.h>' >"$work/alone.cpp"
    # shellcheck disable=SC2086
    c++ -std=c++17 -Wall -Wextra -Werror -fsyntax-only $linked "$work/alone.cpp" ||
        wrong "the header in C++"
}

# run NAME FOLDER: builds FOLDER/NAME.c and runs it in a folder of its own.
run() {
    mkdir -p "$work/run"
    # shellcheck disable=SC2086
    $cc -std=c17 -O1 -Wall -Wextra -Werror $flags "$2/$1.c" -o "$work/$1" $linked -lm ||
        { wrong "$1 is not built"; return; }
    argument=
    [ "$1" != mesh ] || argument=$mesher
    (cd "$work/run" && "$work/$1" $argument) >"$work/$1.out" 2>&1 || {
        cat "$work/$1.out"
        wrong "$1"
    }
    [ -s "$work/$1.out" ] || wrong "$1 prints nothing"
}

examples() {
    for example in "$sources"/docs/examples/*.c; do
        name=${example##*/}
        run "${name%.c}" "$sources/docs/examples"
    done
    [ "$(ls "$sources"/docs/examples/*.c | wc -l)" -ge 10 ] || wrong "there are fewer than ten"
}

page() {
    page=$sources/docs/user/library.md
    grep -q 'pkg-config --cflags --libs gieson-spline' "$page" || wrong "the page has no pkg-config line"
    sed -n '/^```c$/,/^```$/p' "$page" | sed '/^```/d' >"$work/page.c"
    run page "$work"
    case $flags in
    *-fsanitize*) return ;; # an interpreter without a sanitizer loads no library with one
    esac
    /usr/bin/python3 -c 'import numpy' 2>/dev/null || return 0
    sed -n '/^```python$/,/^```$/p' "$page" | sed '/^```/d' >"$work/page.py"
    (cd "$work/run" && PYTHONPATH=$(dirname "$(find "$work/usr" -name gieson_spline.py)") \
        /usr/bin/python3 -W error "$work/page.py") || wrong "the page's Python"
}

$what
exit $status
