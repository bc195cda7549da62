#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# Makes the pictures of docs/user/gallery.md: gallery.sh TOOTH.mhd FOLDER, with gieson on the path.
# TOOTH.mhd is the CT volume of a tooth, 140 x 120 x 161 bytes (its header names no unit of length).
set -eu
store=$(mktemp -d)
trap 'rm -rf "$store"' EXIT
export GIESON_STORE="$store/store"
gieson import --volume "$1" --spacing-unit um --threshold 100 --specimen tooth
gieson run
for picture in "xray" "cut --surface 100 --plane 70,60,80,0.1,-1,0" "light --translucent --window 60,250"; do
    name=${picture%% *}
    options=${picture#"$name"}
    # shellcheck disable=SC2086 # words
    gieson render tooth "$2/gallery-$name.png" --size 300 --view 0.3,1,-0.25 $options
done
