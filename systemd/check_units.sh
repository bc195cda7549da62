#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# What systemd itself says of the units, their user and their directory; no systemd has to run.
#     check_units.sh UNITS FOLDER
# UNITS holds the units whose programs are there, FOLDER the files of the sources.
set -eu
units=$1
folder=$2

for tool in systemd-analyze systemd-sysusers systemd-tmpfiles; do
    if ! command -v $tool >/dev/null; then
        echo "skipped: $tool is not installed"
        exit 77
    fi
done
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
status=0
wrong() {
    echo "$*"
    status=1
}

# Verify may end with 0 and still have said something.
said=$(systemd-analyze verify --man=no --recursive-errors=no "$units"/*.service "$units"/*.timer \
    2>&1) || status=1
[ -z "$said" ] || wrong "$said"

# Tenths: 0 is closed, 100 is open. Above 5 is the one that talks to devices; open is the one that
# runs what the admin says, which may be a mailer.
for unit in "$units"/*.service; do
    most=5
    [ "${unit##*/}" != gieson.service ] || most=10
    [ "${unit##*/}" != gieson-notify@.service ] || most=100
    systemd-analyze security --offline=true --no-pager --threshold=$most "$unit" \
        >"$root/exposure" || wrong "$(cat "$root/exposure")"
    tail -n 1 "$root/exposure"
done

# A timer that says nonsense never fires: its time is read, and comes again.
for timer in "$units"/*.timer; do
    time=$(sed -n 's/^OnCalendar=//p' "$timer")
    systemd-analyze calendar --iterations=2 "$time" >"$root/times" || wrong "${timer##*/}: $time"
    grep -q '^ *Iter. #2' "$root/times" || wrong "${timer##*/} does not come again: $time"
    test -e "${timer%.timer}.service" || wrong "${timer##*/} starts nothing"
    grep -q '^Persistent=true' "$timer" || wrong "${timer##*/} forgets what it missed"
done

mkdir -p "$root/etc" "$root/var/lib"
systemd-sysusers --root="$root" - <"$folder/gieson.sysusers" 2>"$root/said" ||
    wrong "$(cat "$root/said")"
grep -q '^gieson:' "$root/etc/passwd" || wrong "no user gieson is made"
for group in gieson $(sed -n 's/^SupplementaryGroups=//p' "$units/gieson.service"); do
    grep -q "^$group:" "$root/etc/group" || wrong "no group $group is made"
done
# Only root can give it to another.
owner="gieson gieson"
[ "$(id -u)" -eq 0 ] || owner="- -"
sed "s/gieson gieson/$owner/" "$folder/gieson.tmpfiles" |
    systemd-tmpfiles --root="$root" --create - || wrong "the directory is not made"
mode=$(stat -c '%a' "$root/var/lib/gieson")
test "$mode" = 2750 || wrong "the directory has mode $mode"
grep -q '^StateDirectoryMode=2750' "$units/gieson.service" || wrong "the service changes its mode"

# One store for all: where the directory is, where the configuration says, what the timers' services
# are told.
grep -qx 'Directory=/var/lib/gieson' "$folder/gieson.conf" || wrong "gieson.conf has another store"
for unit in gieson-night gieson-scrub gieson-scrub-quick gieson-notify@; do
    grep -qx 'Environment=GIESON_STORE=%S/gieson' "$units/$unit.service" || wrong "$unit: its store"
done

# What the notifying service runs, as it stands in the unit: a paragraph of the night, a sentence of
# the rest, and the result.
mkdir "$root/store"
printf 'a paragraph\n' >"$root/store/night.txt"
printf '#!/bin/sh\necho "$@"\ncat\n' >"$root/notify"
chmod +x "$root/notify"
tell() {
    sed -n "s/^ExecStart=\/bin\/sh -c '\(.*\)'$/\1/p" "$units/gieson-notify@.service" |
        sed -e "s|%i|$1|g" -e 's|\$\$|$|g' -e "s|[^ ]*/notify|$root/notify|" >"$root/told.sh"
    GIESON_STORE="$root/store" MONITOR_SERVICE_RESULT=$2 sh "$root/told.sh"
}
[ "$(tell gieson-night success)" = "gieson-night success
a paragraph" ] || wrong "the night is told as: $(tell gieson-night success)"
[ "$(tell gieson-scrub exit-code)" = "gieson-scrub exit-code
gieson-scrub ended: exit-code. journalctl -u gieson-scrub says what was found." ] ||
    wrong "a look over the store is told as: $(tell gieson-scrub exit-code)"
for unit in gieson-night gieson-scrub gieson-scrub-quick; do
    grep -qx 'OnFailure=gieson-notify@%p.service' "$units/$unit.service" || wrong "$unit fails in silence"
done
exit $status
