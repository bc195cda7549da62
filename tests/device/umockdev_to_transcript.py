#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Turns an ioctl recording of umockdev of a PTP device into the record that acquire/ptp_transport.h
describes. A recording is a tree: below a request lie the reads that followed it, and below the
first line of each depth the alternatives of other runs. The first run that was recorded is taken.

    umockdev_to_transcript.py VENDOR PRODUCT SERIAL RECORDING > RECORD
"""
import sys

BULK_OUT, BULK_IN = "2", "129"


def lines(path):
    for line in open(path, encoding="ascii"):
        words = line.split()
        if words and words[0] == "USBDEVFS_REAPURBNDELAY":
            depth = len(line) - len(line.lstrip(" "))
            endpoint, asked, came = words[3], int(words[6]), int(words[7])
            yield depth, endpoint, asked, came, words[9].lower() if len(words) > 9 else ""


def say(kind, count, filled, text):
    print(f"{kind} {count}{' +' if filled else ''}")
    for at in range(0, 2 * count, 64):
        print(text[at:min(at + 64, 2 * count)])


def main():
    vendor, product, serial, path = sys.argv[1:]
    print(f"gieson-ptp 1 {vendor} {product} 512 {serial}")
    depth = None
    for at, endpoint, asked, came, text in lines(path):
        if endpoint == BULK_OUT:
            say(">", came, False, text)
            depth = at
        elif endpoint == BULK_IN and at == depth + 1:
            say("<", came, came == asked, text)
            depth = at
        elif endpoint == BULK_IN:
            depth = -2  # an alternative: nothing more below this request


main()
