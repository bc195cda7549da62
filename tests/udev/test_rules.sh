#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# udev itself reads our hwdb and applies our rules to modelled devices, with everything else that
# this machine's udev knows. Nothing of the machine changes: it happens in a mount namespace.
#     test_rules.sh SOURCES
set -eu
udev=$1/udev
models=$1/tests/udev
unset LD_PRELOAD # of a sanitizer; these are not our programs

for tool in systemd-hwdb udevadm; do
    if ! command -v $tool >/dev/null; then
        echo "skipped: $tool is not installed"
        exit 77
    fi
done
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
status=0
wrong() {
    echo "wrong: $*"
    status=1
}

# --- hwdb: strict, and it says what is meant and no more
mkdir -p "$work/etc/udev/hwdb.d" "$work/rules"
cp "$udev/65-gieson.hwdb" "$work/etc/udev/hwdb.d/"
printf 'gieson:ptp:04a9:31c0:SN0042\n GIESON_EXCLUSIVE=1\n' >"$work/etc/udev/hwdb.d/90-bench.hwdb"
systemd-hwdb --strict --root="$work" update || wrong "systemd-hwdb does not read the hwdb"
asks() {
    said=$(systemd-hwdb --root="$work" query "$1")
    [ "$said" = "$2" ] || wrong "$1 has '$said', not '$2'"
}
asks gieson:v4l2:0c45:6366:SN0001 GIESON_SERIAL_SHARED=1
asks gieson:v4l2:046d:0825:200901010001 GIESON_SERIAL_SHARED=1
asks gieson:v4l2:0c45:6366:SN00012 ""
asks gieson:ptp:04a9:31c0:SN0001 ""
asks gieson:ptp:04a9:31c0:SN0042 GIESON_EXCLUSIVE=1

# --- rules
if ! command -v umockdev-run >/dev/null || ! unshare -rm true 2>/dev/null; then
    echo "skipped: the rules; umockdev or the right to make a namespace is missing (hwdb was tested)"
    [ $status -eq 0 ] || exit 1
    exit 77
fi
# What v4l_id reads from a camera, since the modelled one answers no ioctl.
echo 'SUBSYSTEM=="video4linux", ENV{ID_V4L_CAPABILITIES}=":capture:"' >"$work/rules/64-model.rules"
cp "$udev/65-gieson.rules" "$work/rules/"
cat >"$work/inside" <<'INSIDE'
mount -t tmpfs none /run && mkdir /run/udev && cp -r "$1/rules" /run/udev/rules.d
[ "$2" = plain ] || mount --bind "$1/etc/udev" /etc/udev
# Links are made in earnest: in a /dev of its own.
mkdir "$1/dev" && touch "$1/dev/null" && mount --bind /dev/null "$1/dev/null"
mount --rbind "$1/dev" /dev
exec udevadm test --action="$3" "/sys$4"
INSIDE
# udev_says MODEL HWDB ACTION DEVPATH: into $work/said
udev_says() {
    rm -rf "${work:?}/dev"
    umockdev-run -d "$1" -- unshare -rm sh "$work/inside" "$work" "$2" "$3" "$4" \
        >"$work/said" 2>&1 || wrong "udevadm failed: $(tail -n 3 "$work/said")"
    ! grep -E '65-gieson.rules.*(Invalid|Unknown|unknown|ignoring|overflow)' "$work/said" ||
        wrong "udev does not understand the rules"
}
has() {
    grep -Eq "$1" "$work/said" || wrong "$now: no $1"
}
lacks() {
    ! grep -Eq "$1" "$work/said" || wrong "$now: $(grep -E "$1" "$work/said")"
}

usb=/devices/pci0000:00/usb1/1-1
for action in add bind change; do
    now="scanner, $action"
    udev_says "$models/scanner.umockdev" plain $action $usb
    has '^ID_USB_INTERFACES=:060101:'
    has '^(CURRENT_)?TAGS=.*:systemd:'
    has '^SYSTEMD_WANTS=gieson.service$'
    has '^DEVLINKS=.*/dev/gieson/ptp-SN0042'
    has '65-gieson.rules:[0-9]+ MODE 0660'
    has "65-gieson.rules:[0-9]+ GROUP $(getent group plugdev | cut -d: -f3)"
    lacks '^GIESON_'
done
now="scanner, remove"
udev_says "$models/scanner.umockdev" plain remove $usb
lacks '^SYSTEMD_WANTS='

now="scanner of the bench alone"
udev_says "$models/scanner.umockdev" bench add $usb
has '^GIESON_EXCLUSIVE=1$'
has '^MTP_NO_PROBE=1$'
lacks '^(ID_GPHOTO2|ID_MTP_DEVICE|ID_MEDIA_PLAYER)='
has '^SYSTEMD_WANTS=gieson.service$'

now="something else on USB"
sed 's/0904000002060101/0904000002080650/' "$models/scanner.umockdev" >"$work/disk.umockdev"
udev_says "$work/disk.umockdev" plain add $usb
has '^ID_USB_INTERFACES=:080650:'
lacks 'gieson.service|/dev/gieson'

video=/devices/pci0000:00/usb1/1-2/1-2:1.0/video4linux/video5
for serial in CAM7 SN0001; do
    now="camera $serial"
    sed "s/@SERIAL@/$serial/" "$models/camera.umockdev" >"$work/camera.umockdev"
    udev_says "$work/camera.umockdev" bench add $video
    has "^ID_SERIAL_SHORT=$serial\$"
    has '^SYSTEMD_WANTS=gieson.service$'
    has '^(CURRENT_)?TAGS=.*:systemd:'
    [ $serial = CAM7 ] || lacks '^DEVLINKS=.*/dev/gieson/'
    [ $serial != CAM7 ] || has '^DEVLINKS=.*/dev/gieson/v4l2-CAM7-0'
done
exit $status
