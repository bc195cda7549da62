#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# Builds the package in two places, with other times, zones and languages around it: the same bytes
# must come out. Then lintian and we look into it.
#     test_package.sh SOURCES VERSION
set -eu
sources=$1
version=$2

for tool in dpkg-buildpackage dh lintian; do
    if ! command -v $tool >/dev/null; then
        echo "skipped: $tool is not installed"
        exit 77
    fi
done
if ! missing=$(cd "$sources" && dpkg-checkbuilddeps 2>&1); then
    echo "skipped: $missing"
    exit 77
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
status=0
wrong() {
    echo "wrong: $*"
    status=1
}

# build PLACE DATE: the tree as it is, without what builds left in it.
build() {
    mkdir -p "$work/$1"
    tar -C "$sources" --exclude=.git --exclude='./build*' --exclude=./demo -cf - . |
        tar -C "$work/$1" -xf -
    find "$work/$1" -exec touch --no-dereference --date="$2" {} +
    (cd "$work/$1" && dpkg-buildpackage -us -uc -b) >"$work/log" 2>&1 || {
        tail -n 40 "$work/log"
        exit 1
    }
}
unset CFLAGS CXXFLAGS LDFLAGS
export DEB_BUILD_OPTIONS="nocheck parallel=2"
build one/gieson 2026-10-01
TZ=Pacific/Auckland LC_ALL=C.UTF-8 build another/place/gieson 2026-11-02
for deb in "$work"/one/*.deb; do
    cmp "$deb" "$work/another/place/${deb##*/}" || wrong "${deb##*/} differs between two builds"
done

changes=$work/one/gieson_${version}_$(dpkg --print-architecture).changes
lintian --allow-root --fail-on error,warning "$changes" || wrong "lintian"

deb=${changes%.changes}.deb
dpkg-deb -x "$deb" "$work/in"
dpkg-deb -e "$deb" "$work/in/DEBIAN"
for file in usr/bin/gieson usr/bin/giesond usr/libexec/gieson/gieson-work \
    usr/libexec/gieson/gieson-mesh usr/libexec/gieson/gieson-phantom \
    lib/systemd/system/gieson.service lib/systemd/system/gieson-worker.service \
    lib/systemd/system/gieson-night.service lib/systemd/system/gieson-night.timer \
    lib/systemd/system/gieson-scrub.service lib/systemd/system/gieson-scrub.timer \
    lib/systemd/system/gieson-scrub-quick.service lib/systemd/system/gieson-scrub-quick.timer \
    usr/lib/sysusers.d/gieson.conf usr/lib/tmpfiles.d/gieson.conf \
    lib/udev/rules.d/65-gieson.rules lib/udev/hwdb.d/65-gieson.hwdb etc/gieson/gieson.conf \
    usr/share/man/man1/gieson.1.gz usr/share/man/man5/gieson.conf.5.gz \
    usr/share/man/man5/gieson-job.5.gz usr/share/man/man8/giesond.8.gz \
    usr/share/doc/gieson/docs/user/README.md usr/share/bash-completion/completions/gieson; do
    test -f "$work/in/$file" || wrong "the package has no $file"
done
# The library's packages, each with its own.
for name in libgieson-spline0 libgieson-spline-dev python3-gieson-spline; do
    dpkg-deb -x "$work/one/${name}_${version}"_*.deb "$work/library"
    ! grep -rlaF "$work" "$work/library" || wrong "the place of the build is in $name"
done
for file in include/gieson-spline/gieson-spline.h include/gieson-spline/pipeline/core/error.h \
    lib/*/libgieson-spline.so lib/*/libgieson-spline.so.0 lib/*/pkgconfig/gieson-spline.pc \
    lib/python3/dist-packages/gieson_spline.py share/man/man3/gieson-spline.3.gz \
    share/man/man3/gsn_field_free.3.gz share/doc/libgieson-spline-dev/examples/mesh.c; do
    # shellcheck disable=SC2086
    test -f "$(echo "$work/library/usr"/$file)" || wrong "the library's packages have no $file"
done
python3 "$sources/tests/docs/test_links.py" "$work/in/usr/share/doc/gieson/docs" || wrong "the manual"
test -d "$work/in/etc/gieson/conf.d" || wrong "the package has no etc/gieson/conf.d"
# Every program that the build makes is in it, also those that are new.
for program in "$work"/one/gieson/obj-*/bin/*; do
    [ "$(find "$work/in/usr/bin" "$work/in/usr/libexec/gieson" -type f -name "${program##*/}" | wc -l)" = 1 ] ||
        wrong "${program##*/} is not in the package"
done
# The units, as they are installed, start programs that are installed, or the base system's shell.
if command -v systemd-analyze >/dev/null; then
    mkdir -p "$work/in/bin"
    cp /bin/sh "$work/in/bin/sh"
    (cd "$work/in/lib/systemd/system" && systemd-analyze verify --man=no --recursive-errors=no \
        --root="$work/in" -- *) || wrong "the units"
fi
"$work/in/usr/bin/gieson" --version | grep -qx "gieson $version" || wrong "gieson is no $version"
! grep -rlaF "$work" "$work/in" || wrong "the place of the build is in the package"
grep -qx /etc/gieson/gieson.conf "$work/in/DEBIAN/conffiles" || wrong "gieson.conf is no conffile"
! grep -n 'rm -r' "$work/in/DEBIAN/postrm" | grep -v 'echo' || wrong "postrm removes trees"
# The licence stands in full where Debian wants it.
sed -n '/^License: AGPL/,/^License: Expat/s/^ //p' "$work/in/usr/share/doc/gieson/copyright" |
    sed 's/^\.$//' >"$work/told"
sed 's/[[:blank:]]*$//' "$sources/LICENSE" >"$work/licence"
tail -n "$(wc -l <"$work/licence")" "$work/told" | diff - "$work/licence" >/dev/null ||
    wrong "debian/copyright has another licence than LICENSE"
exit $status
