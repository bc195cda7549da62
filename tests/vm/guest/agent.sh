#!/bin/bash
# SPDX-License-Identifier: AGPL-3.0-or-later
# The bench's hand in the guest. A line "NUMBER SECONDS BASE64" on the second serial port is a command
# for the shell; the answer is "@@NUMBER STATUS BASE64", its standard output and error together. Past
# its seconds a command is ended with status 124, so that the next one is heard.
stty raw -echo
echo "@@0 0 "
while read -r number seconds command; do
    said=$(timeout -k 5 "$seconds" bash -c "$(base64 -d <<<"$command")" </dev/null 2>&1 | base64 -w0; exit "${PIPESTATUS[0]}")
    echo "@@$number $? $said"
done
