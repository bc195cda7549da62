#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# The services, as the package installs them, are killed 200 times in a booted container while
# specimens come in: each is back within 3 s, no panel is lost or doubled, no job either, and
# nothing half copied is left. Run by hand, as cycle.sh.
#     kills.sh DEB [BASE [KILLS]]
set -eu
deb=$(realpath "$1")
base=${2:-/var/tmp/gieson-base}
kills=${3:-200}
specimens=$((kills / 10))
here=$(dirname "$(realpath "$0")")
root=$(mktemp -d /var/tmp/gieson-kills.XXXXXX)
trap 'umount "$root/proc" 2>/dev/null || true; rm -rf --one-file-system "$root"' EXIT

[ -d "$base/usr" ] || debootstrap --variant=minbase bookworm "$base" >/dev/null
cp -a "$base/." "$root/"
mount -t proc proc "$root/proc"
cp "$deb" "$root/root/gieson.deb"
chroot "$root" sh -c 'export DEBIAN_FRONTEND=noninteractive; apt-get update -q && apt-get install \
    -qy --no-install-recommends /root/gieson.deb' >"$root/log" 2>&1 || {
    tail -n 30 "$root/log"
    exit 1
}
chroot "$root" gieson phantom --specimen S02 --level L0 --px 48 --out /srv/one >/dev/null
umount "$root/proc"
python3 "$here/kills.py" deliver "$root/srv/one" "$root/srv/ready" "$specimens"
mkdir "$root/srv/scans"
printf '[source folder]\nAddress=hot:/srv/scans\nSettleMs=300\nPatienceS=1\nSweepS=1\n' \
    >"$root/etc/gieson/conf.d/10-here.conf"
cat >"$root/root/boot.sh" <<BOOT
kills=$kills
BOOT
cat >>"$root/root/boot.sh" <<'BOOT'
until_true() { # at most a minute
    for i in $(seq 1200); do eval "$1" && return 0; sleep 0.05; done
    return 1
}
pid() { systemctl show -P MainPID "$1"; }
is_back() { [ "$(pid "$1")" != "$2" ] && systemctl is-active -q "$1"; }
# The children of a service, by its control group.
child_of() { cat "/sys/fs/cgroup/system.slice/$1.service/cgroup.procs" \
    "/sys/fs/cgroup/systemd/system.slice/$1.service/cgroup.procs" 2>/dev/null |
    grep -vx "$(pid "$1")" | head -n 1; }
until_true "systemctl is-active -q gieson gieson-worker" || echo "wrong: not started"
worst=0
killed_children=0
for n in $(seq "$kills"); do
    [ $((n % 10)) -ne 1 ] || mv "/srv/ready/$(ls /srv/ready | head -n 1)" /srv/scans/
    service=gieson
    [ $((n % 2)) -eq 0 ] || service=gieson-worker
    if [ $((n % 8)) -ge 6 ]; then # a child: the service itself goes on
        victim=$(child_of $service)
        [ -z "$victim" ] || { kill -KILL "$victim" 2>/dev/null && killed_children=$((killed_children + 1)); }
        continue
    fi
    old=$(pid $service)
    kill -KILL "$old"
    begun=$(date +%s%N)
    until_true "is_back $service $old" || echo "wrong: $service did not come back"
    ms=$((($(date +%s%N) - begun) / 1000000))
    [ $ms -le $worst ] || worst=$ms
done
echo "$kills kills, $killed_children of them of children; a service was back after at most $worst ms"
[ $worst -lt 3000 ] || echo "wrong: too late"
export GIESON_STORE=/var/lib/gieson
for i in $(seq 240); do
    [ "$(gieson status --json | grep -c '"state": "\(reported\|withheld\)"')" != "$((kills / 10))" ] || break
    sleep 1
done
systemctl stop gieson gieson-worker
systemctl poweroff
BOOT
cat >"$root/etc/systemd/system/kills.service" <<'UNIT'
[Service]
ExecStart=sh /root/boot.sh
StandardOutput=file:/root/boot.out
StandardError=inherit
UNIT
mkdir -p "$root/etc/systemd/system/multi-user.target.wants"
ln -s ../kills.service "$root/etc/systemd/system/multi-user.target.wants/"
status=0
timeout 1200 systemd-nspawn -q -D "$root" -b --register=no --keep-unit \
    --system-call-filter="landlock_create_ruleset landlock_add_rule landlock_restrict_self" \
    >"$root/log" 2>&1 || {
    echo "wrong: it did not shut down by itself"
    status=1
}
cat "$root/root/boot.out"
! grep -q '^wrong:' "$root/root/boot.out" || status=1
python3 "$here/kills.py" judge "$root/srv/scans" "$root/var/lib/gieson" "$specimens" || status=1
exit $status
