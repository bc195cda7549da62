#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# What systemd itself says of the unit, its user and its directory; no systemd has to run.
#     check_units.sh UNIT FOLDER
set -eu
unit=$1
folder=$2
most_exposure=15 # tenths: 0 is closed, 100 is open

for tool in systemd-analyze systemd-sysusers systemd-tmpfiles; do
    if ! command -v $tool >/dev/null; then
        echo "skipped: $tool is not installed"
        exit 77
    fi
done
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT

said=$(systemd-analyze verify --man=no --recursive-errors=no "$unit" 2>&1) || {
    echo "$said"
    exit 1
}
if [ -n "$said" ]; then
    echo "$said"
    exit 1
fi
if ! systemd-analyze security --offline=true --no-pager --threshold=$most_exposure "$unit" \
    >"$root/exposure"; then
    cat "$root/exposure"
    exit 1
fi
tail -n 1 "$root/exposure"

mkdir -p "$root/etc" "$root/var/lib"
systemd-sysusers --root="$root" - <"$folder/gieson.sysusers" 2>"$root/said" || {
    cat "$root/said"
    exit 1
}
grep -q '^gieson:' "$root/etc/passwd"
grep -q '^gieson:' "$root/etc/group"
systemd-tmpfiles --root="$root" --create - <"$folder/gieson.tmpfiles"
test "$(stat -c '%a' "$root/var/lib/gieson")" = 750
