#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The virtual bench: gieson installed on Debian's own kernel under systemd, with scanners and cameras
plugged into it, in software. Needs qemu-system-x86 and the kernel's package; no root, no KVM.

    bench.py BUILD --short           plug and unplug
    bench.py BUILD --all             every scenario
    bench.py BUILD NAME...           these scenarios; --list names them
      --cuts N     power cuts of "power" (10)
      --kills N    kills of "kills" (30)
      --package F  what is installed, a .deb (`cmake --install` of BUILD)
      --keep DIR   the folder of kernel, image and frozen machine (BUILD/vm)
      --patience X everything may take X times as long (1)

BUILD is a build folder with all programs. One line a scenario: what, figures, seconds, ok or FAILED; at
the end the seconds of each and of all. A scenario that does not end in its time is FAILED at that.
Exit 0: all that was demanded holds; 1: something does not; 77: this machine cannot run the bench."""
import argparse
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

import image
import machine
from scenarios import SCENARIOS, Bench


def freeze(bench, key):
    """A machine that has booted, with gieson running and nothing plugged in."""
    frozen = bench.home / f"frozen.{key}"
    if frozen.exists():
        return frozen
    for old in bench.home.glob("frozen.*"):
        old.unlink()
    began = time.monotonic()
    booted = machine.Machine(bench.home)
    try:
        booted.until("systemctl is-active gieson.service gieson-worker.service", 300 * bench.patience)
        booted.until("test -e /var/lib/gieson/gieson.db && ! systemctl list-jobs --no-legend | grep -q [0-9]", 120)
        booted.tell("modprobe -a xhci_pci ext4 virtio_blk; udevadm settle; sync")
        failed = booted.tell("systemctl --failed --no-legend --plain; true")
        if failed:
            raise machine.Failed(f"after the boot these units have failed: {failed}")
        print(f"boot: {time.monotonic() - began:.0f} s to multi-user with gieson running, no failed unit; ok",
              flush=True)
        booted.freeze(frozen)
    finally:
        booted.close()
    return frozen


def run_one(bench, name, seconds):
    began = time.monotonic()
    bench.begin(name)
    try:
        figures = SCENARIOS[name](bench)
        verdict = "ok"
    except image.Unavailable as why:
        figures, verdict = str(why), "SKIPPED"
    except (machine.Failed, ValueError, IndexError, OSError) as why:
        figures, verdict = f"{why} (journal: {bench.home / 'failed.journal'})", "FAILED"
    seconds[name] = time.monotonic() - began
    print(f"{name}: {figures}; {seconds[name]:.0f} s, {verdict}", flush=True)
    return verdict


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("name", nargs="*")
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--cuts", type=int, default=10)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--keep", type=pathlib.Path)
    parser.add_argument("--package", type=pathlib.Path, help="the .deb that is installed")
    parser.add_argument("--patience", type=float, default=1)
    asked = parser.parse_args()
    names = asked.name + (list(SCENARIOS) if asked.all else ["plug", "unplug"] if asked.short else [])
    if asked.list or not names or not set(names) <= set(SCENARIOS):
        print("\n".join(f"{name}: {function.__doc__.splitlines()[0]}" for name, function in SCENARIOS.items()))
        return 0 if asked.list else 64
    scratch = pathlib.Path(tempfile.mkdtemp(prefix="gieson-bench."))
    try:
        home = (asked.keep or asked.build / "vm").resolve()
        began = time.monotonic()
        seconds = {}
        key = image.build_image(home, asked.build.resolve(), asked.package)
        print(f"image: {(home / 'root.cpio').stat().st_size / 1e6:.0f} MB of root and Debian's kernel; "
              f"{time.monotonic() - began:.0f} s, ok", flush=True)
        bench = Bench(asked.build.resolve(), home, scratch, asked)
        seconds["image"] = time.monotonic() - began
        bench.frozen = freeze(bench, key)
        seconds["boot"] = time.monotonic() - began - seconds["image"]
        verdicts = [run_one(bench, name, seconds) for name in names]
    except image.Unavailable as why:
        print(f"SKIPPED: {why}")
        return image.SKIPPED
    except machine.Failed as why:
        print(f"the bench cannot be set up: {why}; FAILED")
        return 1
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    print("seconds: " + ", ".join(f"{name} {took:.0f}" for name, took in seconds.items()))
    print(f"{verdicts.count('ok')} of {len(verdicts)} scenarios ok, {verdicts.count('SKIPPED')} skipped, "
          f"{time.monotonic() - began:.0f} s in all")
    return 1 if "FAILED" in verdicts else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except subprocess.CalledProcessError as error:
        sys.exit(f"{error.cmd[0]} ended with {error.returncode}")
