#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# The life of the package in a clean Debian: installed, used, booted, upgraded, removed, purged.
# Run by hand; needs root, debootstrap, systemd-nspawn and a mirror.
#     cycle.sh DEB [BASE]
# BASE is a minimal Debian 12 that is kept for the next time (made by debootstrap when missing).
set -eu
deb=$(realpath "$1")
base=${2:-/var/tmp/gieson-base}
root=$(mktemp -d /var/tmp/gieson-cycle.XXXXXX)
trap 'umount "$root/proc" 2>/dev/null || true; rm -rf --one-file-system "$root"' EXIT
status=0
wrong() {
    echo "wrong: $*"
    status=1
}
inside() {
    chroot "$root" env DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 "$@"
}
stage() {
    echo "== $*"
}

[ -d "$base/usr" ] || debootstrap --variant=minbase bookworm "$base" >/dev/null
cp -a "$base/." "$root/"
mount -t proc proc "$root/proc"

stage install
cp "$deb" "$root/root/gieson.deb"
inside apt-get update -q >/dev/null
inside apt-get install -qy --no-install-recommends /root/gieson.deb >"$root/log" 2>&1 || {
    tail -n 30 "$root/log"
    exit 1
}
for unit in gieson.service gieson-worker.service gieson-night.timer gieson-scrub.timer \
    gieson-scrub-quick.timer; do
    [ "$(inside systemctl is-enabled $unit)" = enabled ] || wrong "$unit is not enabled"
done
[ "$(stat -c %a "$root/var/lib/gieson")" = 2750 ] || wrong "the store's place is too open or shut"
inside gieson --version
inside giesond --version

stage "use: as the owner takes in, a technician reads"
inside useradd -m -G gieson tech
inside useradd -m stranger
inside su gieson -s /bin/sh -c 'cd /tmp &&
    gieson phantom --specimen S00 --level L0 --px 36 --out /tmp/scans/S00 >/dev/null &&
    gieson --store /var/lib/gieson import /tmp/scans/S00'
inside su tech -c 'gieson --store /var/lib/gieson status' || wrong "a technician cannot read"
! inside su stranger -c 'gieson --store /var/lib/gieson status' 2>/dev/null ||
    wrong "a stranger reads the store"
inside su gieson -s /bin/sh -c 'gieson --store /var/lib/gieson run' || wrong "no job was worked"
inside su tech -c 'gieson --store /var/lib/gieson report GVP-D-S00 --json' | grep -q mean ||
    wrong "a technician gets no report"

stage "boot: the services start, and start again"
mkdir "$root/srv/scans"
printf '[source folder]\nAddress=hot:/srv/scans\nPatienceS=2\n' >"$root/etc/gieson/conf.d/10-here.conf"
inside gieson phantom --specimen S02 --level L0 --px 36 --out /srv/scans/S02 >/dev/null
cat >"$root/root/boot.sh" <<'BOOT'
until_true() { # at most a minute
    for i in $(seq 600); do eval "$1" && return 0; sleep 0.1; done
    return 1
}
is_another() { [ "$(systemctl show -P MainPID $1)" != "$2" ] && systemctl is-active -q $1; }
for service in gieson gieson-worker; do
    until_true "systemctl is-active -q $service" || echo "wrong: $service is not active"
    old=$(systemctl show -P MainPID $service)
    [ "$old" -gt 1 ] || continue
    kill -KILL "$old"
    killed=$(date +%s%N)
    until_true "is_another $service $old" || echo "wrong: $service did not come back"
    ms=$((($(date +%s%N) - killed) / 1000000))
    echo "$service was back $ms ms after it was killed"
    [ $ms -lt 3000 ] || echo "wrong: too late"
done
export GIESON_STORE=/var/lib/gieson
until_true 'gieson report GVP-D-S02 >/dev/null 2>&1' || echo "wrong: the folder was not worked"
gieson status
[ "$(gieson status | grep -c reported)" -eq 2 ] || echo "wrong: a specimen has no figures"
systemctl reload gieson gieson-worker || echo "wrong: no reload"
for service in gieson-night gieson-scrub gieson-scrub-quick; do
    systemctl start $service || { echo "wrong: $service failed"; journalctl --no-pager -u $service; }
done
old=$(systemctl show -P MainPID gieson)
kill -STOP "$old"
until_true "is_another gieson $old" || echo "wrong: a hang was not noticed"
systemctl status --no-pager gieson gieson-worker
systemctl stop gieson gieson-worker
! systemctl is-failed gieson gieson-worker || echo "wrong: stopped with a failure"
journalctl --no-pager -p warning -u 'gieson*'
systemctl poweroff
BOOT
cat >"$root/etc/systemd/system/cycle.service" <<'UNIT'
[Unit]
After=gieson.service gieson-worker.service
[Service]
Type=simple
ExecStart=sh /root/boot.sh
StandardOutput=file:/root/boot.out
StandardError=inherit
UNIT
mkdir -p "$root/etc/systemd/system/multi-user.target.wants"
ln -s ../cycle.service "$root/etc/systemd/system/multi-user.target.wants/"
umount "$root/proc"
timeout 180 systemd-nspawn -q -D "$root" -b --register=no --keep-unit \
    --system-call-filter="landlock_create_ruleset landlock_add_rule landlock_restrict_self" \
    >"$root/log" 2>&1 || wrong "it did not shut down by itself"
cat "$root/root/boot.out"
! grep -q '^wrong:' "$root/root/boot.out" || status=1
rm -f "$root/etc/systemd/system/multi-user.target.wants/cycle.service"
mount -t proc proc "$root/proc"

stage "upgrade: what an administrator changed stays"
echo '#changed here' >>"$root/etc/gieson/gieson.conf"
dpkg-deb -R "$deb" "$root/next"
sed -i 's/^Version: .*/&+1/' "$root/next/DEBIAN/control"
dpkg-deb -b --root-owner-group "$root/next" "$root/root/next.deb" >/dev/null
inside apt-get install -qy /root/next.deb >"$root/log" 2>&1 || wrong "upgrade: $(tail -n 5 "$root/log")"
inside dpkg-query -W gieson
grep -q '^#changed here' "$root/etc/gieson/gieson.conf" || wrong "the configuration was overwritten"
inside su tech -c 'gieson --store /var/lib/gieson status' >/dev/null || wrong "the store is unread"

stage "remove: programs go, settings and store stay"
sums() {
    (cd "$root/var/lib/gieson/objects" && find . -type f | sort | xargs sha256sum)
}
before=$(sums)
inside apt-get remove -qy gieson >"$root/log" 2>&1 || wrong "remove: $(tail -n 5 "$root/log")"
[ ! -e "$root/usr/bin/gieson" ] || wrong "gieson is still there"
[ -e "$root/etc/gieson/gieson.conf" ] || wrong "the settings are gone"
[ "$(sums)" = "$before" ] || wrong "the store changed"

stage "purge: settings go, the store stays, and that is said"
inside dpkg --purge gieson 2>&1 | tee "$root/said"
grep -q 'was kept: /var/lib/gieson' "$root/said" || wrong "nobody is told where the store is"
[ ! -e "$root/etc/gieson/gieson.conf" ] || wrong "the settings are still there"
[ -z "$(find "$root/etc/systemd" -name 'gieson*')" ] || wrong "links of units are left"
[ "$(sums)" = "$before" ] || wrong "the store changed"

stage "install again: the store is found"
inside apt-get install -qy /root/gieson.deb >"$root/log" 2>&1 || wrong "again: $(tail -n 5 "$root/log")"
inside su tech -c 'gieson --store /var/lib/gieson status' || wrong "the store is unread"

stage "purge of an empty one: nothing is left"
rm -rf "$root/var/lib/gieson" "$root/etc/gieson"
inside apt-get purge -qy gieson >"$root/log" 2>&1 || wrong "purge: $(tail -n 5 "$root/log")"
! find "$root/etc" "$root/var/lib" "$root/usr" -name '*gieson*' | grep . || wrong "something is left"
exit $status
