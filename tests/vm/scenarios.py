# SPDX-License-Identifier: AGPL-3.0-or-later
"""What happens on the bench, and what must be true afterwards. Every scenario has a machine of its
own, waits for conditions and never for a time, and gives its figures in words."""
import base64
import concurrent.futures
import hashlib
import io
import os
import pathlib
import random
import signal
import struct
import subprocess
import tarfile
import time
import zlib

from image import Unavailable, configured_root
from machine import Budget, Failed, Machine

SCENARIOS = {}
BUDGET = {}
DB = "/var/lib/gieson/gieson.db"


def scenario(seconds):
    """A scenario and the seconds it has, a few times those it takes in emulation on two cores."""
    def register(function):
        SCENARIOS[function.__name__] = function
        BUDGET[function.__name__] = seconds
        return function
    return register


def demand(claim, sentence):
    if not claim:
        raise Failed(sentence)


class Bench:
    def __init__(self, build, home, scratch, asked):
        self.build, self.home, self.scratch = build, home, scratch
        self.cuts, self.kills, self.patience = asked.cuts, asked.kills, asked.patience
        self.frozen = None
        self.budget = None
        self.random = random.Random(1)

    def begin(self, name):
        self.budget = Budget(self.wait(BUDGET[name]))

    def machine(self):
        return Machine(self.home, self.frozen, self.budget)

    def wait(self, seconds):
        return seconds * self.patience

    def sim(self):
        found = sorted(self.build.rglob("gieson-sim"))
        if not found:
            raise Unavailable("gieson-sim is not built")
        return found[0]

    def tiff(self, name, width, height):
        """An RGB TIFF nobody has seen before, uncompressed: its size on the bus is known."""
        path = self.scratch / name
        row = self.random.randbytes(3 * width)
        rows = b"".join(row[3 * y % len(row):] + row[:3 * y % len(row)] for y in range(height))
        tags = ((256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, 200), (259, 3, 1, 1), (262, 3, 1, 2),
                (273, 4, 1, 512), (277, 3, 1, 3), (278, 4, 1, height), (279, 4, 1, len(rows)))
        head = b"II*\0" + struct.pack("<IH", 8, len(tags))
        head += b"".join(struct.pack("<HHII", *tag) for tag in tags) + b"\0\0\0\0"
        head = head.ljust(200, b"\0") + struct.pack("<HHH", 8, 8, 8)
        path.write_bytes(head.ljust(512, b"\0") + rows)
        return path


PNG_HEAD = 33  # bytes of signature and first chunk


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(number):
    """A small PNG of its own for each number."""
    rows = b"".join(b"\0" + number.to_bytes(4, "big") * 6 for _ in range(8))
    return (b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", struct.pack(">IIBBBBB", 8, 8, 8, 2, 0, 0, 0)) +
            png_chunk(b"IDAT", zlib.compress(rows)) + png_chunk(b"IEND", b""))


def sha256(path):
    return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()


# ---- the guest ----------------------------------------------------------------------------

def sql(vm, query):
    return vm.tell(f'sqlite3 -readonly -cmd ".timeout 20000" {DB} "{query}"')


def sql_is(query, answer):
    return f'test "$(sqlite3 -readonly -cmd ".timeout 20000" {DB} "{query}")" = "{answer}"'


def configure(vm, sources):
    """Sets the sources of the bench as an administrator does."""
    text = base64.b64encode(sources.encode()).decode()
    vm.tell(f"cd $(ls -d /etc/gieson /usr/local/etc/gieson 2>/dev/null | head -1) && mkdir -p conf.d && "
            f"base64 -d <<<{text} >conf.d/bench.conf && gieson check-config && systemctl reload-or-restart gieson.service gieson-worker.service")


def put(vm, files, folder):
    """Small files into the guest: name -> bytes."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    text = base64.b64encode(packed.getvalue()).decode()
    for at in range(0, len(text), 60000):
        vm.tell(f"echo {text[at:at + 60000]} >>/run/put.b64")
    vm.tell(f"mkdir -p {folder} && base64 -d /run/put.b64 | tar -xzf - -C {folder} && rm /run/put.b64")


def check_objects(vm, demanded=None, query="SELECT name, sha256 FROM scan"):
    """Every row of the ledger has its exact object; with demanded (name -> hash), these are there."""
    rows = [tuple(line.split("|")) for line in sql(vm, query).splitlines()]
    hashes = vm.tell("cd /var/lib/gieson/objects && sha256sum ??/* 2>/dev/null; true").splitlines()
    here = {line.split()[1].replace("/", ""): line.split()[0] for line in hashes}
    for name, digest in (demanded or {}).items():
        demand((name, digest) in rows, f"{name} was acknowledged and is gone")
    for name, digest in rows:
        demand(here.get(digest) == digest, f"the row of {name} has no object with its bytes")
    demand(len(set(rows)) == len(rows), "a scan is in the ledger twice")


def temporaries(vm):
    return vm.tell("find /var/lib/gieson/objects/tmp /var/lib/gieson/tmp -type f 2>/dev/null; true")


PTP = "[source scanner]\nAddress=ptp:any\nSettleMs=300\nSweepS=2\n"


# ---- scanners -----------------------------------------------------------------------------

@scenario(seconds=90)
def plug(bench):
    """a scanner is plugged in: udev starts the service, its scans are rows with equal bytes"""
    first, second = bench.tiff("first.tif", 900, 700), bench.tiff("second.tif", 600, 500)
    with bench.machine() as vm:
        configure(vm, PTP)
        vm.tell("systemctl stop gieson.service")
        began = time.monotonic()
        sim = vm.plug(bench.sim(), "ptp", first, second)
        started = vm.until("systemctl is-active gieson.service", bench.wait(60))
        vm.until(sql_is("SELECT count(*) FROM scan", 1), bench.wait(120))
        taken = time.monotonic() - began
        check_objects(vm, {"first.tif": sha256(first)})
        sim.signal(signal.SIGUSR1)
        event = vm.until(sql_is("SELECT count(*) FROM scan", 2), bench.wait(120))
        check_objects(vm, {"first.tif": sha256(first), "second.tif": sha256(second)})
        demand(sql(vm, "SELECT state FROM source") == "ready", "the source is not ready afterwards")
        link = vm.tell("ls /dev/gieson")
        demand(link.startswith("ptp-"), f"/dev/gieson holds {link!r}")
    return (f"plug -> udev -> service {started:.1f} s -> row {taken:.1f} s, equal; ObjectAdded -> row "
            f"{event:.1f} s, equal; link {link}")


@scenario(seconds=90)
def unplug(bench):
    """unplugged in mid-object and plugged in again: the copy goes on where it stopped"""
    large = bench.tiff("large.tif", 2000, 1700)  # 10.2 MB
    with bench.machine() as vm:
        configure(vm, PTP)
        # The device counts anew after the replug, so a copy begun over would be broken off again.
        sim = vm.plug(bench.sim(), "ptp", "--fault", "unplug_at_byte=6000000", large)
        vm.until("ls /dev/gieson/ptp-*", bench.wait(60))
        gone = vm.until(f'! ls /dev/gieson/ptp-* 2>/dev/null && {sql_is("SELECT state FROM source", "away")}',
                        bench.wait(180))
        demand(sql(vm, "SELECT count(*) FROM scan") == "0", "half an object has a row")
        began = time.monotonic()
        sim.signal(signal.SIGUSR2)
        vm.until(sql_is("SELECT count(*) FROM scan", 1), bench.wait(180))
        again = time.monotonic() - began
        check_objects(vm, {"large.tif": sha256(large)})
        demand(temporaries(vm) == "", f"temporaries are left: {temporaries(vm)}")
    return (f"broken off at 6.0 of {large.stat().st_size / 1e6:.1f} MB, source away after {gone:.1f} s; resumed and "
            f"equal {again:.1f} s after the replug")


@scenario(seconds=120)
def mtp(bench):
    """a scanner that is not ours: qemu's usb-mtp; a file renamed into it, two written in place, slowly"""
    folder = bench.scratch / "mtp"
    folder.mkdir()
    there, renamed = bench.tiff("there.tif", 500, 400), bench.tiff("renamed.tif", 600, 400)
    written, halved = bench.tiff("written.tif", 700, 300), bench.tiff("halved.tif", 700, 310)
    (folder / "there.tif").write_bytes(there.read_bytes())
    with bench.machine() as vm:
        configure(vm, PTP)
        vm.plug_mtp(folder)
        vm.until(sql_is("SELECT count(*) FROM scan", 1), bench.wait(120))
        os.rename(renamed, folder / "renamed.tif")
        vm.until(sql_is("SELECT count(*) FROM scan", 2), bench.wait(120))
        with open(folder / "written.tif", "wb", buffering=0) as file:
            content = written.read_bytes()
            for at in range(0, len(content), 1 << 16):
                file.write(content[at:at + (1 << 16)])
                time.sleep(0.1)
        equal = sql_is(f"SELECT count(*) FROM scan WHERE sha256 = '{sha256(folder / 'written.tif')}'", 1)
        vm.until(equal, bench.wait(60))
        # This responder measures an object when it sees it first, and tells of no change.
        content = halved.read_bytes()
        halved.write_bytes(content[:300000])
        os.rename(halved, folder / "halved.tif")
        vm.until("journalctl -q --no-pager | grep -q 'halved.tif is not whole yet'", bench.wait(60))
        with open(folder / "halved.tif", "ab", buffering=0) as file:
            file.write(content[300000:])
        vm.until(sql_is("SELECT count(*) FROM scan", 4), bench.wait(60))
        check_objects(vm, {p.name: sha256(folder / p.name) for p in (there, renamed, written, halved)})
    return "usb-mtp: 4 objects equal (there, renamed in, written in place, read at half its size)"


UMTP = """manufacturer "bench"
product "umtp"
serial "UMTP1"
firmware_version "1"
interface "Still Image"
storage "/srv/umtp" "panels" "rw"
usb_vendor_id  0x1D6B
usb_product_id 0x0100
usb_class 0x6
usb_subclass 0x1
usb_protocol 0x1
usb_dev_version 0x3008
usb_functionfs_mode 0x1
usb_dev_path   "/dev/ffs-umtp/ep0"
usb_epin_path  "/dev/ffs-umtp/ep1"
usb_epout_path "/dev/ffs-umtp/ep2"
usb_epint_path "/dev/ffs-umtp/ep3"
usb_max_packet_size 0x200
"""
GADGET = """set -e
modprobe -a dummy_hcd libcomposite usb_f_fs
mount -t configfs none /sys/kernel/config 2>/dev/null || true
g=/sys/kernel/config/usb_gadget/umtp; mkdir -p $g/strings/0x409 $g/configs/c.1/strings/0x409 $g/functions/ffs.umtp
echo 0x1D6B >$g/idVendor; echo 0x0100 >$g/idProduct; echo UMTP1 >$g/strings/0x409/serialnumber
echo bench >$g/strings/0x409/manufacturer; echo umtp >$g/strings/0x409/product
echo c >$g/configs/c.1/strings/0x409/configuration; ln -s $g/functions/ffs.umtp $g/configs/c.1/
mkdir -p /dev/ffs-umtp; mount -t functionfs umtp /dev/ffs-umtp
systemd-run --quiet --unit=umtp umtprd -conf /etc/umtprd/umtprd.conf
for i in $(seq 300); do test -e /dev/ffs-umtp/ep3 && break; sleep 0.1; done
ls /sys/class/udc | head -1 >$g/UDC
"""


@scenario(seconds=90)
def umtp(bench):
    """a scanner that is not ours: umtp-responder on FunctionFS and dummy_hcd"""
    panel = bench.tiff("umtp.tif", 300, 200)
    with bench.machine() as vm:
        if vm.run("command -v umtprd")[0] != 0:
            raise Unavailable("umtp-responder is not installed here")
        put(vm, {"umtp.tif": panel.read_bytes()}, "/srv/umtp")
        put(vm, {"umtprd.conf": UMTP.encode()}, "/etc/umtprd")
        configure(vm, PTP)
        vm.tell(GADGET, bench.wait(90))
        vm.until(sql_is("SELECT count(*) FROM scan", 1), bench.wait(120))
        check_objects(vm, {"umtp.tif": sha256(panel)})
    return "umtp-responder on FunctionFS: equal"


# ---- cameras ------------------------------------------------------------------------------

def frames_of(bench, width, height, count):
    """Raw YUY2, each frame its own."""
    frames = [bench.random.randbytes(width) * 2 * height for _ in range(count)]
    path = bench.scratch / "frames.yuv"
    path.write_bytes(b"".join(frames))
    return path, [hashlib.sha256(frame).hexdigest() for frame in frames]


def captured(vm, source, payload_bytes, seconds):
    """Asks for a picture; gives the hash of its payload: the PAM without its header."""
    before = int(sql(vm, "SELECT count(*) FROM scan"))
    # Refused while the picture before is still to come.
    vm.until(f"gieson --store /var/lib/gieson capture {source}", seconds)
    # One that was asked for earlier may come first.
    vm.until(sql_is(f"SELECT count(*) > {before} FROM scan", 1), seconds)
    digest = sql(vm, "SELECT sha256 FROM scan ORDER BY id DESC LIMIT 1")
    path = f"/var/lib/gieson/objects/{digest[:2]}/{digest[2:]}"
    return vm.tell(f"tail -c {payload_bytes} {path} | sha256sum").split()[0]


CAMERA = "[source camera]\nAddress={address}\nFormat=YUYV\nWidth={width}\nHeight={height}\nAtRest=no\n"


@scenario(seconds=120)
def camera(bench):
    """a UVC camera by V4L2 and by libcamera: the frames are equal to those that were played"""
    width, height = 320, 240
    path, played = frames_of(bench, width, height, 40)
    figures = []
    with bench.machine() as vm:
        vm.tell("modprobe uvcvideo")
        sim = vm.plug(bench.sim(), "uvc", width, height, path)
        vm.until("ls /dev/v4l/by-id/*-video-index0", bench.wait(60))
        name = vm.tell("ls /dev/v4l/by-id | grep -m1 video-index0")
        addresses = [f"v4l2:{name}"]
        listed = vm.run("cam -l 2>/dev/null | sed -n 's/.*(\\(.*\\)).*/\\1/p' | head -1", bench.wait(60))[1].strip()
        needed = subprocess.run(["ldd", str(bench.build / "bin/gieson-intake")], capture_output=True, text=True,
                                check=False).stdout
        if listed and "libcamera.so" in needed:
            addresses.append(f"libcamera:{listed}")
        for address in addresses:
            configure(vm, CAMERA.format(address=address, width=width, height=height))
            vm.until(sql_is("SELECT state FROM source WHERE name = 'camera'", "ready"), bench.wait(90))
            for _ in range(2):
                digest = captured(vm, "camera", 2 * width * height, bench.wait(90))
                demand(digest in played, f"a frame by {address} is none that was played")
            figures.append(f"2 frames by {address.split(':')[0]} equal")
        sim.unplug()
        away = vm.until(sql_is("SELECT state FROM source WHERE name = 'camera'", "away"), bench.wait(60))
        figures.append(f"unplugged: away after {away:.1f} s")
    if len(addresses) == 1:
        figures.append("libcamera: not in this build" if listed else "libcamera: `cam -l` lists no camera")
    return "; ".join(figures)


VIVID_RULE = ('SUBSYSTEM=="video4linux", ATTR{name}=="vivid-000-vid-cap", SYMLINK+="v4l/by-id/vivid"')


@scenario(seconds=180)
def vivid(bench):
    """the kernel's test camera with injected errors: the source survives and says so"""
    with bench.machine() as vm:
        vm.tell(f"echo '{VIVID_RULE}' >/etc/udev/rules.d/90-vivid.rules && udevadm control --reload && "
                "modprobe vivid n_devs=1 node_types=0x1 && udevadm settle && ls /dev/v4l/by-id/vivid", 120)
        configure(vm, CAMERA.format(address="v4l2:vivid", width=640, height=360))
        vm.until(sql_is("SELECT state FROM source WHERE name = 'camera'", "ready"), bench.wait(90))
        captured(vm, "camera", 1, bench.wait(90))
        said = []
        controls = vm.tell("v4l2-ctl -d /dev/v4l/by-id/vivid -l")
        for control, value in (("inject_vidioc_qbuf_error", 1), ("inject_vidioc_streamon_error", 1),
                               ("percentage_of_dropped_buffers", 50), ("inject_fatal_streaming_error", 1),
                               ("disconnect", 1)):
            if control not in controls:
                continue
            vm.run(f"v4l2-ctl -d /dev/v4l/by-id/vivid -c {control}={value}")
            vm.run(f"timeout {bench.wait(60):.0f} gieson --store /var/lib/gieson capture camera", bench.wait(90))
            vm.run("v4l2-ctl -d /dev/v4l/by-id/vivid -c percentage_of_dropped_buffers=0")
            if control != "disconnect":
                captured(vm, "camera", 1, bench.wait(120))
                said.append(control)
        demand(vm.run("systemctl is-active gieson.service")[0] == 0, "the service is gone")
        restarts = vm.tell("systemctl show -P NRestarts gieson.service")
        demand(restarts == "0", f"the service was restarted {restarts} times")
        message = sql(vm, "SELECT state || ': ' || message FROM source WHERE name = 'camera'")
        check_objects(vm)
    return f"survived {', '.join(said)}; after disconnect the source is {message!r}"


# ---- work ---------------------------------------------------------------------------------

def specimen(bench, name):
    """Two small panels and their job, drawn by the tests' own hand; no other specimen has their bytes."""
    draw = bench.build / "tests/test_vm_specimen"
    if not draw.exists():
        raise Unavailable("test_vm_specimen is not built")
    folder = bench.scratch / name
    folder.mkdir(exist_ok=True)
    subprocess.run([str(draw)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                   env={**os.environ, "GIESON_SPECIMEN": str(folder), "GIESON_SPECIMEN_NAME": name})
    files = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    return {file: content if file == "job.json" else content[:PNG_HEAD] +
            png_chunk(b"tEXt", b"Title\0" + name.encode()) + content[PNG_HEAD:] for file, content in files.items()}


# ---- power --------------------------------------------------------------------------------

FSTAB = "/dev/disk/by-id/virtio-store /var/lib/gieson ext4 defaults 0 0\n"
ACKNOWLEDGED = ("SELECT name, sha256 FROM scan UNION "
                "SELECT s.name || '/' || file_name, sha256 FROM panel p JOIN specimen s ON s.id = p.specimen_id")


class Lives:
    """The lives of one machine with one disk. Each begins with the power switched on and ends with the
    power cut in the middle of a job; the next one judges what is left of it and gets its own load."""

    def __init__(self, bench, name, cuts):
        self.bench, self.name, self.cuts = bench, name, cuts
        self.random = random.Random(name)
        self.files = [bench.tiff(f"{name}-{i:02}.tif", 300, 250 + i) for i in range(2 * cuts + 4)]
        self.boots, self.acknowledged, self.scans, self.specimens = {}, {}, 0, 0
        self.disk = bench.scratch / f"{name}.disk"
        with open(self.disk, "wb") as to:
            to.truncate(96 << 20)
        subprocess.run(["/sbin/mke2fs", "-q", "-t", "ext4", "-F", str(self.disk)], check=True)

    def switch_on(self):
        return Machine(self.bench.home, None, self.bench.budget, "powered.cpio", self.disk, processors=1)

    def check_boot(self, vm):
        """It started from nothing, and systemd by itself mounted the disk and started the services."""
        vm.until("systemctl is-active gieson.service gieson-worker.service", self.bench.wait(120))
        seconds = time.monotonic() - vm.began
        boot, up, mounted = vm.tell("cat /proc/sys/kernel/random/boot_id; cut -d. -f1 /proc/uptime; "
                                    "findmnt -no SOURCE,FSTYPE /var/lib/gieson").splitlines()
        demand(boot not in self.boots, f"the machine did not boot anew: it is boot {boot} again")
        demand(int(up) <= time.monotonic() - vm.began + 2, f"the machine is up for {up} s, longer than it has power")
        demand(mounted.split() == ["/dev/vda", "ext4"], f"the store is on {mounted}")
        if self.boots:
            demand(vm.run("journalctl -qk --no-pager | grep -q 'vda.*recovery complete'")[0] == 0,
                   "the kernel did not replay the journal of a disk that was cut off")
        self.boots[boot] = seconds

    def judge(self, vm):
        """Nothing acknowledged is lost, and the job that was cut off gets done though nobody asks for it."""
        check_objects(vm, self.acknowledged, ACKNOWLEDGED)
        lost = sql(vm, "SELECT kind || ' ' || id || ': ' || message FROM job WHERE state = 'failed' OR attempts > 0")
        demand(lost == "", f"jobs are given up, or a cut was counted as their death: {lost}")
        begun = ",".join(sql(vm, "SELECT id FROM job WHERE claim > 0 AND state <> 'done'").split())
        vm.until(sql_is(f"SELECT count(*) FROM job WHERE id IN ({begun}) AND state <> 'done'", 0), self.bench.wait(120))

    def import_specimen(self, vm):
        name = f"{self.name}{self.specimens}"
        put(vm, specimen(self.bench, name), f"/srv/{name}")
        vm.tell(f"runuser -u gieson -- gieson --store /var/lib/gieson import /srv/{name}", self.bench.wait(90))
        self.specimens += 1

    def load(self, vm, cut):
        """Scans come from a scanner and, whenever there is nothing left to do, a specimen from a folder.
        What happens next, once a job was begun, is that the power is gone."""
        sim = vm.plug(self.bench.sim(), "ptp", *self.files)
        sim.finish_scans(2 * cut + 4)
        vm.until(sql_is(f"SELECT count(*) >= {self.scans + 1 + cut % 2} FROM scan WHERE source = 'scanner'", 1),
                 self.bench.wait(180))
        claims, left = sql(vm, "SELECT coalesce(sum(claim), 0), count(*) FILTER (WHERE state <> 'done') "
                               "FROM job").split("|")
        if left == "0":
            self.import_specimen(vm)
        self.acknowledged = dict(line.split("|") for line in sql(vm, ACKNOWLEDGED).splitlines())
        self.scans = sum("/" not in known for known in self.acknowledged)
        vm.until(sql_is(f"SELECT sum(claim) > {claims} OR max(state = 'running') FROM job", 1), self.bench.wait(120))
        time.sleep(self.random.uniform(0, 1.5))
        vm.cut()

    def check_reports(self, vm):
        reports = sql(vm, "SELECT report_sha256 || '  /var/lib/gieson/' || report_path FROM run "
                          "WHERE state IN ('reported', 'withheld')")
        demand(len(reports.splitlines()) == self.specimens,
               f"{self.specimens} specimens were taken in, and these are the reports: {reports!r}")
        vm.tell(f"sha256sum --strict --quiet -c <<<'{reports}'")

    def end(self, vm):
        """All the rest comes in and gets done, and the disk is sound. Gives how many jobs were begun again."""
        sim = vm.plug(self.bench.sim(), "ptp", *self.files)
        sim.finish_scans(len(self.files))
        vm.until(sql_is("SELECT count(*) FROM scan WHERE source = 'scanner'", len(self.files)), self.bench.wait(300))
        vm.until(sql_is("SELECT count(*) FROM job WHERE state <> 'done'", 0), self.bench.wait(120))
        if self.specimens:
            self.check_reports(vm)
        demand(sql(vm, "PRAGMA integrity_check") == "ok", "the database is damaged")
        again = int(sql(vm, "SELECT coalesce(sum(claim - 1), 0) FROM job"))
        vm.tell("systemctl stop gieson.service gieson-worker.service")
        check_objects(vm, {**self.acknowledged, **{f.name: sha256(f) for f in self.files}}, ACKNOWLEDGED)
        demand(temporaries(vm) == "", f"temporaries are left: {temporaries(vm)}")
        vm.tell("umount /var/lib/gieson")
        vm.cut()
        checked = subprocess.run(["/sbin/e2fsck", "-fn", str(self.disk)], capture_output=True, text=True, check=False)
        demand(checked.returncode == 0, f"the file system is damaged: {checked.stdout[-300:]}")
        return again

    def live(self):
        for cut in range(self.cuts + 1):
            with self.switch_on() as vm:
                self.check_boot(vm)
                self.judge(vm)
                if cut == self.cuts:
                    return self.end(vm)
                self.load(vm, cut)


@scenario(seconds=420)
def power(bench):
    """the power is cut at moments of intake and work; after a boot nothing is lost and the work is done"""
    configured_root(bench.home, "powered.cpio", "[store]\nReserveMiB=4\n" + PTP, FSTAB)
    # Two machines beside each other: one alone does not keep two processors busy while it boots.
    machines = [Lives(bench, "A", (bench.cuts + 1) // 2), Lives(bench, "B", bench.cuts // 2)]
    with concurrent.futures.ThreadPoolExecutor(len(machines)) as pool:
        again = sum(pool.map(Lives.live, machines))
    boots = [seconds for lives in machines for seconds in lives.boots.values()]
    demand(again > 0 or bench.cuts < 2, "none of the cuts met a job: they prove nothing about the work")
    known = sum(len(lives.acknowledged) for lives in machines)
    return (f"{bench.cuts} cuts of two machines, {len(boots)} boots from power-on in {min(boots):.0f} to "
            f"{max(boots):.0f} s; {known} scans and panels acknowledged, 0 lost; {again} jobs cut off and done by "
            f"themselves; {sum(len(lives.files) for lives in machines)} scans in, once each")


@scenario(seconds=90)
def timer(bench):
    """the clock comes to half past two: the nightly run writes the report of what changed"""
    files = specimen(bench, "S1")
    with bench.machine() as vm:
        vm.tell("systemctl stop gieson-worker.service")
        put(vm, files, "/srv/S1")
        vm.tell("runuser -u gieson -- gieson --store /var/lib/gieson import /srv/S1", 60)
        demand(sql(vm, "SELECT count(*) FROM run") == "0", "there is a run before the night")
        # The delay spreads several machines; here there is one.
        vm.tell("mkdir -p /etc/systemd/system/gieson-night.timer.d && printf '[Timer]\\nRandomizedDelaySec=0\\n"
                "AccuracySec=1s\\n' >/etc/systemd/system/gieson-night.timer.d/bench.conf && "
                "systemctl daemon-reload && date -s '2030-01-15 02:29:55' && systemctl restart gieson-night.timer", 90)
        took = vm.until(sql_is("SELECT count(*) FROM run WHERE state IN ('reported', 'withheld')", 1), bench.wait(300))
        report = sql(vm, "SELECT report_path || '|' || report_sha256 FROM run ORDER BY id DESC LIMIT 1").split("|")
        found = vm.tell(f"sha256sum /var/lib/gieson/{report[0]}").split()[0]
        demand(found == report[1], "the report is not the one that its row tells of")
        # A oneshot is never active: it is activating, then inactive or failed.
        vm.until("systemctl show -P ActiveState gieson-night.service | grep -qxE 'inactive|failed'", bench.wait(60))
        # Its one specimen states no region: all is withheld, which `night` says by its exit status.
        ended = vm.tell("systemctl show -P ExecMainStatus gieson-night.service")
        demand(ended == "65", f"the night of a specimen that is withheld ended with {ended}")
        listed = vm.tell("systemctl show -P NextElapseUSecRealtime gieson-night.timer")
        demand("2030-01-16 02:30" in listed, f"the next night is {listed}")
    return f"02:30 -> report {took:.0f} s later; next night {listed}"


@scenario(seconds=90)
def sandbox(bench):
    """decoder and mesher behind all their walls, under the service's own limits"""
    with bench.machine() as vm:
        status, said = vm.run("cat /sys/kernel/security/lsm 2>/dev/null || "
                              "(mount -t securityfs none /sys/kernel/security && cat /sys/kernel/security/lsm)")
        demand(status == 0 and "landlock" in said, f"the guest's kernel has no Landlock: {said}")
        files = specimen(bench, "S1")
        files["P02.png"] = files["P02.png"][:2000]
        put(vm, {f"S1/{name}": content for name, content in files.items()}, "/srv/scans")
        configure(vm, "[source folder]\nAddress=hot:/srv/scans\nSettleMs=300\nPatienceS=2\n")
        vm.until(sql_is("SELECT count(*) FROM panel WHERE state = 'registered'", 1), bench.wait(180))
        vm.until(sql_is("SELECT count(*) FROM panel WHERE state = 'refused'", 1), bench.wait(180))
        vm.until(sql_is("SELECT count(*) FROM job WHERE state <> 'done'", 0), bench.wait(300))
        said = sql(vm, "SELECT message FROM panel WHERE state = 'refused'")
        demand("truncated PNG" in said, f"the panel is refused with {said!r}")
    return f"Landlock and seccomp under the worker's service; one panel registered, one refused ({said[:40]}...)"


# ---- accidents ----------------------------------------------------------------------------

@scenario(seconds=360)
def kills(bench):
    """service, intake and worker are killed again and again: back in 3 s, nothing lost or doubled"""
    script = (pathlib.Path(__file__).parent / "guest/kills.sh").read_text(encoding="utf-8")
    with bench.machine() as vm:
        put(vm, {f"{i:03}.png": png(i) for i in range(bench.kills)}, "/srv/pictures")
        put(vm, {f"S1/{name}": content for name, content in specimen(bench, "S1").items()}, "/srv/scans")
        put(vm, {"kills.sh": script.encode()}, "/run")
        configure(vm, "[source folder]\nAddress=hot:/srv/scans\nSettleMs=100\nSweepS=1\n")
        vm.until(sql_is("SELECT state FROM source", "ready"), bench.wait(90))
        said = vm.tell(f"bash /run/kills.sh {bench.kills}", bench.wait(60 + 12 * bench.kills)).splitlines()[-1]
        slowest, start = (int(said.split(word)[1].split()[0]) / 1000 for word in ("slowest return", "start takes"))
        vm.until(sql_is("SELECT count(*) FROM scan WHERE name LIKE '%.png' AND length(name) = 7", bench.kills),
                 bench.wait(120))
        check_objects(vm)
        vm.until(sql_is("SELECT count(*) FROM job WHERE state IN ('waiting', 'running')", 0), bench.wait(180))
        lost = sql(vm, "SELECT kind || ' ' || id || ': ' || message FROM job WHERE state <> 'done'")
        demand(lost == "", f"jobs are lost: {lost}")
        jobs = sql(vm, "SELECT kind, count(*) FROM job GROUP BY kind").split()
        demand(jobs == ["panel|2", "specimen|1"], f"two panels and a specimen are the jobs {jobs}")
        doubled = sql(vm, "SELECT count(*) FROM (SELECT 1 FROM job GROUP BY kind, specimen_id, panel_id "
                          "HAVING count(*) > 1 AND min(claim) = 0)")
        runs = sql(vm, "SELECT count(*) FROM (SELECT key FROM run GROUP BY key HAVING count(*) > 1)")
        demand(doubled == "0" and runs == "0", f"{doubled} jobs and {runs} runs are doubled")
        vm.tell("systemctl restart gieson.service")
        vm.until(sql_is("SELECT state FROM source", "ready"), bench.wait(90))
        demand(temporaries(vm) == "", f"temporaries are left: {temporaries(vm)}")
        # A second of it is RestartSec=; where emulation makes a mere start slow, it takes as much more.
        allowed = bench.patience * max(3, 1 + 2 * start)
        demand(slowest < allowed, f"slowest return {slowest} s, and not within {allowed:.1f} s")
    return f"{said} (allowed: {allowed:.1f} s); {bench.kills} pictures in once each, jobs done, temporaries swept"


@scenario(seconds=120)
def hang(bench):
    """the service hangs: the watchdog ends it and it comes back"""
    with bench.machine() as vm:
        configure(vm, "[source folder]\nAddress=hot:/srv/scans\n")
        vm.tell("mkdir -p /srv/scans")
        pid = vm.tell("systemctl show -P MainPID gieson.service")
        vm.tell(f"kill -STOP {pid}")
        took = vm.until(f'p=$(systemctl show -P MainPID gieson.service); test "$p" != 0 && test "$p" != {pid} && '
                        "systemctl is-active gieson.service", bench.wait(120))
        result = vm.run("journalctl -q -u gieson.service | grep -c -i 'watchdog timeout'")[1].strip()
        demand(result not in ("", "0"), "the journal knows of no watchdog")
    return f"stopped by a signal, killed by the watchdog and back {took:.0f} s later"
