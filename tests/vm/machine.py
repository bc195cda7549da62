# SPDX-License-Identifier: AGPL-3.0-or-later
"""One virtual machine of the bench: started, asked, plugged into, cut off; in software (TCG), as an
ordinary user.

A machine that has booted can be frozen into a file, and any number of machines thawed from it: they
go on where it stood, a second later. So every scenario has a fresh machine and only one pays for the
boot. Freezing needs nothing plugged in; USB devices come later, as they do on a bench."""
import base64
import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import tempfile
import time

MEMORY_MIB = 1536


class Failed(Exception):
    """What was demanded did not happen; the text says what did."""


class Budget:
    """The seconds that a scenario has in all, so that one which waits for what never comes is ended
    and says at what."""

    def __init__(self, seconds):
        self.seconds = seconds
        self.end = time.monotonic() + seconds

    def left(self, what):
        left = self.end - time.monotonic()
        if left <= 0:
            raise Failed(f"the scenario's {self.seconds:.0f} s are over at: {what}")
        return left


class Line:
    """A socket that speaks in lines."""

    def __init__(self, path, process, seconds=30):
        end = time.monotonic() + seconds
        self.socket = socket.socket(socket.AF_UNIX)
        self.rest = b""
        while True:
            try:
                self.socket.connect(str(path))
                return
            except OSError:
                if time.monotonic() > end or process.poll() is not None:
                    raise Failed(f"qemu does not answer on {path}") from None
                time.sleep(0.02)

    def say(self, text):
        self.socket.sendall(text.encode() + b"\n")

    def hear(self, seconds):
        end = time.monotonic() + seconds
        while b"\n" not in self.rest:
            left = end - time.monotonic()
            if left <= 0:
                raise Failed(f"no answer within {seconds:.0f} s")
            self.socket.settimeout(left)
            try:
                got = self.socket.recv(1 << 16)
            except TimeoutError:
                continue
            except OSError as error:
                raise Failed(f"the machine is gone ({error})") from None
            if not got:
                raise Failed("the machine is gone")
            self.rest += got
        line, self.rest = self.rest.split(b"\n", 1)
        return line.decode(errors="replace").strip("\r")


class Machine:
    def __init__(self, image, frozen=None, budget=None, root="root.cpio", disk=None, processors=2):
        self.budget = budget or Budget(600)
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="gieson-vm."))
        self.image = image
        self.console = self.folder / "console"
        self.number = 0
        self.sims = []
        self.process = subprocess.Popen(self.command(image, frozen, root, disk, processors), stdin=subprocess.DEVNULL,
                                        stdout=open(self.folder / "qemu.log", "w", encoding="utf-8"),
                                        stderr=subprocess.STDOUT)
        self.began = time.monotonic()
        try:
            self.meet(frozen)
        except Failed:
            self.close()
            raise

    def meet(self, frozen):
        """Waits until the machine is there and its agent listens."""
        self.monitor = Line(self.folder / "qmp", self.process)
        self.monitor.hear(30)
        self.ask("qmp_capabilities")
        self.agent = Line(self.folder / "agent", self.process)
        if frozen:
            self.wait_for_thaw(120)
            return
        try:
            self.wait_for_answer(0, 300)
        except Failed as why:
            said = self.console.read_text(encoding="utf-8", errors="replace").strip()
            raise Failed(f"the machine does not boot: {why}; its console says {said[-300:]!r}") from None

    def command(self, image, frozen, root, disk, processors):
        # A fifth level of page tables is a fifth more to walk, in software.
        command = ["setpriv", "--pdeathsig", "KILL", "qemu-system-x86_64", "-M", "pc",
                   "-accel", "tcg,thread=multi", "-cpu", "max,la57=off", "-smp", str(processors),
                   "-m", str(MEMORY_MIB), "-nodefaults", "-display", "none", "-no-reboot",
                   "-kernel", image / "vmlinux", "-initrd", image / root,
                   "-append", "console=ttyS0 quiet panic=-1 mitigations=off apparmor=0 audit=0 nowatchdog "
                              "8250.nr_uarts=2 systemd.show_status=0",
                   "-serial", f"file:{self.console}",
                   "-chardev", f"socket,id=agent,path={self.folder}/agent,server=on,wait=off",
                   "-serial", "chardev:agent",
                   "-qmp", f"unix:{self.folder}/qmp,server=on,wait=off",
                   "-device", "qemu-xhci,id=xhci,p2=8,p3=8"]
        if disk:
            command += ["-drive", f"file={disk},if=none,id=disk,format=raw", "-device",
                        "virtio-blk-pci,drive=disk,serial=store"]
        if frozen:
            command += ["-incoming", f"exec:cat {frozen}"]
        return [str(word) for word in command]

    # ---- qemu ------------------------------------------------------------------------------

    def ask(self, what, **arguments):
        self.monitor.say(json.dumps({"execute": what, "arguments": arguments}))
        while True:
            answer = json.loads(self.monitor.hear(60))
            if "error" in answer:
                raise Failed(f"qemu: {what}: {answer['error']['desc']}")
            if "return" in answer:
                return answer["return"]

    def wait_for_thaw(self, seconds):
        end = time.monotonic() + seconds
        while self.ask("query-status")["status"] == "inmigrate":
            if time.monotonic() > end:
                raise Failed(f"the machine is not thawed within {seconds} s")
            time.sleep(0.05)
        self.ask("cont")

    def freeze(self, path):
        """Into a file, without an end: the machine is over."""
        self.ask("stop")
        self.ask("migrate-set-parameters", **{"max-bandwidth": 1 << 40})
        self.ask("migrate", uri=f"exec:cat > {path}.new")
        while True:
            state = self.ask("query-migrate")["status"]
            if state == "completed":
                break
            if state in ("failed", "cancelled"):
                raise Failed("the machine cannot be frozen")
            time.sleep(0.1)
        self.cut()
        os.replace(f"{path}.new", path)

    def cut(self):
        """The power is gone: what the guest had not synced is lost."""
        if self.process.poll() is None:
            os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def close(self):
        for sim in self.sims:
            sim.unplug()
        self.cut()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self):
        return self

    def __exit__(self, kind, *why):
        if kind is Failed and self.process.poll() is None:
            self.budget = Budget(60)
            try:
                (self.image / "failed.journal").write_text(self.journal(400), encoding="utf-8")
            except Failed:
                pass
        self.close()

    # ---- the guest -------------------------------------------------------------------------

    def wait_for_answer(self, number, seconds):
        end = time.monotonic() + seconds
        while True:
            words = self.agent.hear(max(end - time.monotonic(), 0.01)).split(" ")
            if words[0] == f"@@{number}":
                said = base64.b64decode(words[2]).decode(errors="replace") if len(words) > 2 else ""
                return int(words[1]), said

    def run(self, command, seconds=60):
        """The command's exit status and what it said."""
        seconds = min(seconds, self.budget.left(command))
        began = time.monotonic()
        self.number += 1
        self.agent.say(f"{self.number} {seconds:.1f} {base64.b64encode(command.encode()).decode()}")
        try:
            # The guest ends it in time; only a guest that hangs does not say so.
            status, said = self.wait_for_answer(self.number, seconds + 20)
        except Failed as why:
            raise Failed(f"{command}: {why}") from None
        if status in (124, 137) and time.monotonic() - began > 0.9 * seconds:
            self.budget.left(command)
            raise Failed(f"{command}: not over within {seconds:.0f} s; it said {said.strip()[-300:]!r}")
        return status, said

    def tell(self, command, seconds=60):
        """What the command says; it must end well."""
        status, said = self.run(command, seconds)
        if status != 0:
            raise Failed(f"{command} ended with {status}: {said.strip()[-600:]}")
        return said.strip()

    def until(self, command, seconds, demanded=None):
        """Asks again and again until the command ends well and, if demanded, says just that.
        Gives the seconds it took."""
        began = time.monotonic()
        while True:
            asked = time.monotonic()
            status, said = self.run(command, max(seconds, 30))
            if status == 0 and (demanded is None or said.strip() == demanded):
                return time.monotonic() - began
            if time.monotonic() - began > seconds:
                raise Failed(f"not within {seconds} s: {command}"
                             f"{f' says {demanded}' if demanded is not None else ''}; "
                             f"it says {said.strip()[-300:]!r} ({status})")
            # In emulation a question costs the guest more than a little of what it is to get done.
            time.sleep(min(time.monotonic() - asked, 1))

    def journal(self, lines=40):
        return self.run(f"journalctl -q --no-pager -n {lines}", 60)[1]

    # ---- what is plugged in ----------------------------------------------------------------

    def plug(self, program, *words):
        """A device that a process of ours plays (tests/device/sim.c), behind qemu's usb-redir."""
        sim = Sim(self, program, words)
        self.sims.append(sim)
        return sim

    def plug_mtp(self, folder):
        """qemu's own Still Image device; its storage is the folder."""
        self.ask("device_add", driver="usb-mtp", id="mtp", bus="xhci.0", rootdir=str(folder), desc="Scanner",
                 readonly=True)


class Sim:
    count = 0

    def __init__(self, machine, program, words):
        Sim.count += 1
        self.name = f"sim{Sim.count}"
        self.machine = machine
        path = machine.folder / self.name
        machine.ask("chardev-add", id=self.name, backend={"type": "socket", "data": {
            "addr": {"type": "unix", "data": {"path": str(path)}}, "server": True, "wait": False}})
        machine.ask("device_add", driver="usb-redir", chardev=self.name, id=self.name, bus="xhci.0")
        self.log = open(machine.folder / f"{self.name}.log", "w", encoding="utf-8")
        self.process = subprocess.Popen([str(program), str(path), *map(str, words)], stdin=subprocess.DEVNULL,
                                        stdout=self.log, stderr=subprocess.STDOUT)

    def signal(self, number):
        self.process.send_signal(number)

    def unplug(self):
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(10)
        self.log.close()

    def finish_scans(self, count):
        """Lets the scanner finish so many scans in all, as fast as it can. It listens to signals once
        the guest has seen it."""
        self.machine.until("ls /dev/gieson/ptp-*", 60)
        for there in range(1, count):
            end = time.monotonic() + 20
            self.signal(signal.SIGUSR1)
            while pathlib.Path(self.log.name).read_text(encoding="utf-8").count(" is there") <= there:
                if time.monotonic() > end:
                    raise Failed("the simulated scanner does not finish its scans")
                time.sleep(0.005)
