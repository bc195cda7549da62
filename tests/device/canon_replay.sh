#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# A camera that exists, replayed by umockdev-run to the byte, gives both photos to our PTP
# conversation over libusb:
#     canon_replay.sh CLIENT SHARED PRELOAD
# CLIENT is canon_client, PRELOAD the libraries it needs first. Exit 77: the recording is not here.
set -eu
client=$1 data=${GIESON_SHARED:-$2}/data/device preload=$3
if [ ! -r "$data/canon-powershot-sx200.ioctl" ]; then
    echo "the recording of a camera is not here: $data"
    exit 77
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/truth"
tar -C "$work/truth" -xf "$data/test-photos.tar"
umockdev-run -d "$data/canon-powershot-sx200.umockdev" \
    -i "/dev/bus/usb/001/011=$data/canon-powershot-sx200.ioctl" -- \
    env LD_PRELOAD="$preload" timeout 60 "$client" "$work/IMG_0001.JPG" "$work/IMG_0002.JPG"
for name in IMG_0001.JPG IMG_0002.JPG; do
    cmp "$work/$name" "$(find "$work/truth" -name "$name")"
    echo "$name: $(wc -c < "$work/$name") bytes, equal"
done
