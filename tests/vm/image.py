# SPDX-License-Identifier: AGPL-3.0-or-later
"""The two files that the virtual bench boots: Debian's own kernel, and one initramfs with systemd and
gieson in it, made from the files of packages that are installed on this machine.

Nothing is installed and no root rights are needed. The one download is the kernel's package (70 MB),
kept in the folder given. The archive is written directly (cpio, "newc"), so no tree is copied and
every file belongs to root whoever builds it.
"""
import hashlib
import lzma
import os
import pathlib
import re
import shutil
import stat
import subprocess

SKIPPED = 77
GUEST = pathlib.Path(__file__).resolve().parent / "guest"

# In the root with everything they depend on; and alone.
PACKAGES = ("systemd udev kmod dbus dash bash coreutils util-linux mount sed grep findutils "
            "procps libusb-1.0-0 dpkg tar gzip base-files").split()
ALONE = ("libcamera-ipa", "fonts-dejavu-core")
PROGRAMS = ("sqlite3", "v4l2-ctl", "cam", "umtprd")
# What may be loaded in the guest; modprobe knows what those need in turn.
MODULES = ("virtio_pci virtio_blk ext4 autofs4 xhci_pci xhci_hcd uvcvideo vivid dummy_hcd libcomposite usb_f_fs "
           "usb_storage sd_mod vfat nls_ascii nls_cp437 rtc_cmos").split()
NOT_IN = re.compile(r"^/usr/share/(doc|man|locale|info|lintian|i18n|zoneinfo|perl|X11|bash-completion)/"
                    r"|/gconv/|^/usr/lib/udev/hwdb\.d/|^/lib/udev/hwdb\.d/|^/usr/lib/python|^/usr/include/|\.a$"
                    # of the units that are made at a boot, those of fstab are needed
                    r"|/system-generators/(?!systemd-fstab-)")
# Units that only cost time in a machine that is thrown away.
MASKED = ("systemd-networkd systemd-timesyncd systemd-firstboot ldconfig systemd-update-done "
          "systemd-journal-catalog-update systemd-journal-flush systemd-pstore apt-daily getty@tty1 "
          "systemd-random-seed systemd-logind systemd-user-sessions systemd-update-utmp "
          "systemd-update-utmp-runlevel systemd-machine-id-commit systemd-modules-load systemd-binfmt "
          "systemd-remount-fs systemd-sysext systemd-repart kmod-static-nodes modprobe@configfs modprobe@dm_mod "
          "modprobe@drm modprobe@efi_pstore modprobe@fuse modprobe@loop").split()
MASKED_OTHERS = ("apt-daily.timer apt-daily-upgrade.timer dpkg-db-backup.timer systemd-tmpfiles-clean.timer "
                 "e2scrub_all.timer dev-hugepages.mount dev-mqueue.mount sys-kernel-config.mount "
                 "sys-kernel-debug.mount sys-kernel-tracing.mount sys-fs-fuse-connections.mount "
                 "proc-sys-fs-binfmt_misc.automount").split()


class Unavailable(Exception):
    """Something this machine does not have; the bench is skipped and says so."""


def output(*command, **more):
    return subprocess.run(command, capture_output=True, text=True, check=False, **more).stdout


def need_programs():
    for program, package in (("qemu-system-x86_64", "qemu-system-x86"), ("modprobe", "kmod"),
                             ("dpkg", "dpkg"), ("apt-get", "apt")):
        if not shutil.which(program):
            raise Unavailable(f"{program} is not here (package {package})")


# ---- kernel -------------------------------------------------------------------------------

def kernel(folder):
    """Downloads and unpacks the kernel once; gives its tree."""
    tree = folder / "kernel"
    if (tree / "complete").exists():
        return tree
    names = re.findall(r"Depends: (linux-image-\S+)", output("apt-cache", "depends", "linux-image-amd64"))
    if not names:
        raise Unavailable("no package source knows linux-image-amd64")
    found = sorted(folder.glob(f"{names[0]}_*.deb"))
    if not found:
        done = subprocess.run(["apt-get", "download", "-q", names[0]], cwd=folder, capture_output=True,
                              text=True, check=False)
        found = sorted(folder.glob(f"{names[0]}_*.deb"))
        if not found:
            raise Unavailable(f"{names[0]} cannot be downloaded: {done.stderr.strip()[-200:]}")
    shutil.rmtree(tree, ignore_errors=True)
    subprocess.run(["dpkg", "-x", found[0], tree], check=True)
    version = next((tree / "lib/modules").iterdir()).name
    subprocess.run(["depmod", "-b", tree, version], check=True)
    (tree / "complete").touch()
    return tree


def unpacked_kernel(tree):
    """The kernel as an ELF file, which qemu starts by its PVH note: xz takes half a second here, and in
    a machine in software eight at each boot. One that is packed otherwise stays as it is."""
    packed = next((tree / "boot").glob("vmlinuz-*")).read_bytes()
    at = packed.find(b"\xfd7zXZ\0")
    unpacked = lzma.LZMADecompressor().decompress(packed[at:]) if at >= 0 else b""
    return unpacked if unpacked.startswith(b"\x7fELF") else packed


def module_files(tree):
    """(path in the guest, file here) of the modules and of what modprobe looks them up in."""
    version = next((tree / "lib/modules").iterdir()).name
    home = tree / "lib/modules" / version
    files = {}
    for module in MODULES:
        shown = output("modprobe", "-d", str(tree), "-S", version, "--show-depends", module)
        for path in re.findall(r"^insmod (\S+)", shown, re.M):
            files[path[path.index("/lib/modules/"):]] = pathlib.Path(path)
    for path in home.glob("modules.*"):
        files[f"/lib/modules/{version}/{path.name}"] = path
    return {"/usr" + name: path for name, path in files.items()}


# ---- what is installed here ---------------------------------------------------------------

def package_files():
    closure = output("apt-cache", "depends", "--recurse", "--no-recommends", "--no-suggests",
                     "--no-conflicts", "--no-breaks", "--no-replaces", "--no-enhances", "--installed",
                     *PACKAGES)
    names = sorted(set(re.findall(r"^[a-z0-9]\S*", closure, re.M))) + list(ALONE)
    here = [n for n in names if output("dpkg-query", "-W", "-f", "${db:Status-Status}", n) == "installed"]
    return [p for p in output("dpkg", "-L", *here).splitlines() if p.startswith("/")]


def libraries(programs):
    found = set()
    for line in output("ldd", *map(str, programs)).splitlines():
        match = re.search(r"(/\S+) \(0x", line)
        if match:
            found.add(match.group(1))
    return sorted(found)


def in_guest(path):
    """Where a file of this machine goes: /bin, /sbin, /lib are links into /usr there."""
    return re.sub(r"^/(bin|sbin|lib|lib64)/", r"/usr/\1/", str(path))


class Archive:
    """Files of the guest by name, written as one cpio at the end."""

    def __init__(self):
        self.entry = {}

    def folder(self, name, mode=0o755):
        if name not in ("/", ""):
            self.folder_of(name)
            self.entry.setdefault(name, (stat.S_IFDIR | mode, b""))

    def folder_of(self, name):
        parent = os.path.dirname(name)
        if parent not in ("/", ""):
            self.folder(parent)

    def text(self, name, text, mode=0o644):
        self.folder_of(name)
        self.entry[name] = (stat.S_IFREG | mode, text.encode())

    def link(self, name, target):
        self.folder_of(name)
        self.entry[name] = (stat.S_IFLNK | 0o777, target.encode())

    def file(self, name, path):
        self.folder_of(name)
        self.entry[name] = (stat.S_IFREG | stat.S_IMODE(path.stat().st_mode), path)

    def take(self, path):
        """A file of this machine under its own name, with all links on the way to it."""
        for _ in range(8):
            if os.path.islink(path):
                target = os.readlink(path)
                self.link(in_guest(path), in_guest(target) if target.startswith("/") else target)
                path = os.path.normpath(os.path.join(os.path.dirname(path), target))
            elif os.path.isfile(path):
                self.file(in_guest(path), pathlib.Path(path))
                return
            else:
                return

    def tree(self, root, at=""):
        for path in sorted(root.rglob("*")):
            name = in_guest(at + "/" + path.relative_to(root).as_posix())
            if path.is_symlink():
                self.link(name, os.readlink(path))
            elif path.is_file():
                self.file(name, path)

    def append(self, to):
        """To what the file holds already: in the guest the later entry of a name counts."""
        for inode, (name, (mode, content)) in enumerate(sorted(self.entry.items()), 1):
            body = content.read_bytes() if isinstance(content, pathlib.Path) else content
            self.write_one(to, name.lstrip("/"), inode, mode, body)
        self.write_one(to, "TRAILER!!!", 0, 0, b"")

    @staticmethod
    def write_one(to, name, inode, mode, body):
        fields = (inode, mode, 0, 0, 1, 0, len(body), 0, 0, 0, 0, len(name) + 1, 0)
        head = b"070701" + b"".join(b"%08x" % f for f in fields) + name.encode() + b"\0"
        to.write(head + b"\0" * (-len(head) % 4))
        to.write(body + b"\0" * (-len(body) % 4))


# ---- the root -----------------------------------------------------------------------------

def add_system(archive):
    for name in ("proc", "sys", "dev", "run", "tmp", "root", "srv", "media", "var/lib", "var/log", "var/tmp",
                 "etc/systemd/system", "etc/udev/rules.d"):
        archive.folder("/" + name)
    for name in ("bin", "sbin", "lib", "lib64"):
        archive.folder("/usr/" + name)
        archive.link("/" + name, "usr/" + name)
    archive.link("/init", "usr/lib/systemd/systemd")
    files = [p for p in package_files() if not NOT_IN.search(p)]
    programs = [shutil.which(p) for p in PROGRAMS if shutil.which(p)]
    loaded = [p for p in files if re.search(r"/libcamera/.*\.so$", p)]
    for path in files + programs + libraries(programs + loaded):
        if not os.path.isdir(path) or os.path.islink(path):
            archive.take(path)
    for name in ("passwd", "group"):
        archive.file(f"/etc/{name}", pathlib.Path(f"/usr/share/base-passwd/{name}.master"))
    archive.take("/etc/nsswitch.conf")


def add_settings(archive):
    archive.text("/etc/hostname", "bench\n")
    archive.text("/etc/machine-id", "%032d\n" % 1)
    archive.text("/etc/fstab", "")
    for unit in [u + ".service" for u in MASKED] + MASKED_OTHERS:
        archive.link(f"/etc/systemd/system/{unit}", "/dev/null")
    archive.link("/etc/systemd/system/default.target", "/usr/lib/systemd/system/multi-user.target")
    archive.link("/etc/systemd/system/multi-user.target.wants/agent.service", "../agent.service")
    archive.file("/etc/systemd/system/agent.service", GUEST / "agent.service")
    archive.file("/usr/bin/agent", GUEST / "agent.sh")
    archive.entry["/usr/bin/agent"] = (stat.S_IFREG | 0o755, GUEST / "agent.sh")
    archive.text("/etc/systemd/journald.conf.d/bench.conf", "[Journal]\nStorage=volatile\nRateLimitIntervalSec=0\n")


def add_gieson(archive, build, package, folder):
    """What the Debian package, or else `cmake --install` of this build, puts on a machine, with the
    libraries it needs. What its scripts do beyond that, systemd does at the first boot."""
    stage = folder / "stage"
    shutil.rmtree(stage, ignore_errors=True)
    if package:
        subprocess.run(["dpkg-deb", "-x", package, stage], check=True)
    else:
        subprocess.run(["cmake", "--install", build, "--strip"], env={**os.environ, "DESTDIR": str(stage)},
                       check=True, stdout=subprocess.DEVNULL)
    archive.tree(stage)
    programs = [p for p in stage.rglob("*") if p.is_file() and os.access(p, os.X_OK)
                and p.read_bytes()[:4] == b"\x7fELF"]
    for path in libraries(programs):
        archive.take(path)
    for unit in sorted(stage.rglob("*.service")) + sorted(stage.rglob("*.timer")):
        text = unit.read_text(encoding="utf-8")
        for wants in re.findall(r"^WantedBy=(\S+)", text, re.M):
            archive.link(f"/etc/systemd/system/{wants}.wants/{unit.name}",
                         in_guest("/" + unit.relative_to(stage).as_posix()))


def build_image(folder, build, package):
    """Makes folder/vmlinux and folder/root.cpio; gives a name for what is in them."""
    need_programs()
    folder.mkdir(parents=True, exist_ok=True)
    tree = kernel(folder)
    archive = Archive()
    add_system(archive)
    add_settings(archive)
    for name, path in module_files(tree).items():
        archive.file(name, path)
    add_gieson(archive, build, package, folder)
    (folder / "vmlinux").write_bytes(unpacked_kernel(tree))
    key = hashlib.sha256()
    for name, (mode, content) in sorted(archive.entry.items()):
        if isinstance(content, pathlib.Path):
            status = content.stat()
            # What was stripped is as old as the stripping, so its bytes tell.
            stripped = content.is_relative_to(folder / "stage")
            content = (hashlib.sha256(content.read_bytes()).digest() if stripped else
                       f"{content} {status.st_size} {status.st_mtime_ns}".encode())
        key.update(f"{name} {mode} ".encode() + content)
    key = key.hexdigest()[:16]
    if not (folder / "root.key").exists() or (folder / "root.key").read_text() != key:
        with open(folder / "root.cpio", "wb") as to:
            archive.append(to)
        (folder / "root.key").write_text(key)
    return key


def configured_root(folder, name, sources, fstab):
    """Makes the root folder/name, whose machine has this configuration and these disks from its start."""
    home = next((folder / "stage").rglob("etc/gieson/gieson.conf")).parent.relative_to(folder / "stage")
    more = Archive()
    more.text(f"/{home}/conf.d/bench.conf", sources)
    more.text("/etc/fstab", fstab)
    shutil.copyfile(folder / "root.cpio", folder / name)
    with open(folder / name, "ab") as to:
        more.append(to)
