#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# giesond, gieson-intake and gieson stay light: a crash in mathematics must not be able to reach
# them. Reads the libraries each program needs, all the way down, and refuses OpenCV and TetGen.
#     needed_libraries.sh PROGRAM...
status=0
for program in "$@"; do
    found=$(ldd "$program" | grep -oE 'lib(opencv|tet)[^ ]*' | sort -u | tr '\n' ' ')
    if [ -n "$found" ]; then
        echo "$program needs $found"
        status=1
    else
        echo "$program: light"
    fi
done
exit $status
