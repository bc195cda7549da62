#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""A night by Slurm gives the bytes of a night without, also when a daemon and a node are killed on the way.

    slurm_night.py BIN     ends with 77 where Slurm is not installed

A cluster of Debian's Slurm with two nodes of one processor each, both on this machine, without systemd,
munge or root: slurmctld and two slurmd. Twenty specimens, half of them controls, are imported into two
stores alike; one night is worked here and one by `gieson night --slurm`, and every file of the reports
and of the study is compared. On the way the daemon of the first node is killed alone and started again: its
task does not notice. Then the second node is killed with all that runs on it, and stays away: another task
computes its specimen, and Slurm begins its task anew.
"""
import getpass
import json
import os
import pathlib
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time

from study_whole import write_volume

COUNT = 20
PATIENCE_S = 300


def check(claim, sentence):
    if not claim:
        raise SystemExit(f"not true: {sentence}")


def wait_for(what, sentence, log=lambda: "", patience_s=PATIENCE_S):
    """Until what() is true; its value."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        value = what()
        if value:
            return value
        time.sleep(0.2)
    raise SystemExit(f"not true within {patience_s} s: {sentence}\n{log()}")


def free_ports(count):
    taken = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [s.getsockname()[1] for s in taken]
    for s in taken:
        s.close()
    return ports


def node_of(pid):
    """The node that this process is a part of, its task or the shepherd of one, or None."""
    try:
        words = pathlib.Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:
        return None
    return next((w.split(b"=")[1].decode() for w in words
                 if w.startswith((b"SLURMD_NODENAME=", b"SHEPHERD_NODENAME="))), None)


class Cluster:
    """slurmctld and a slurmd a node."""
    NODES = ("n1", "n2")

    def __init__(self, folder):
        self.folder, self.running = folder, {}
        host, ports = socket.gethostname().split(".")[0], free_ports(1 + len(self.NODES))
        self.env = dict(os.environ, SLURM_CONF=str(folder / "slurm.conf"))
        nodes = "\n".join(f"NodeName={n} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1"
                          for n, port in zip(self.NODES, ports[1:]))
        # No daemon for secrets and no accounts; short times, so that a node that died is soon noticed.
        (folder / "slurm.conf").write_text(f"""ClusterName=bench
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser={getpass.getuser()}
SlurmdUser={getpass.getuser()}
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
MailProg=/bin/true
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=bf_interval=1,sched_interval=1,batch_sched_delay=0
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
SlurmdTimeout=5
MessageTimeout=3
KillWait=2
JobRequeue=1
{nodes}
PartitionName=all Nodes={",".join(self.NODES)} Default=YES State=UP MaxTime=INFINITE
""")
        (folder / "state").mkdir()

    def __enter__(self):
        self.start("slurmctld", "slurmctld", "-D")
        for node in self.NODES:
            (self.folder / f"spool-{node}").mkdir()
            self.start_node(node)
        wait_for(lambda: self.call("sinfo", "-h", "-t", "idle", "-o", "%D") == "2", "two nodes idle", self.log)
        return self

    def __exit__(self, *_):
        """No process of ours is left, whatever failed."""
        if self.running["slurmctld"].poll() is None:
            subprocess.run(["scancel", f"--user={getpass.getuser()}"], env=self.env, capture_output=True)
        for node in self.NODES:
            self.kill_node(node)
        for child in self.running.values():
            child.kill()
            child.wait()

    def log(self):
        return "\n".join(f"{p.name}: {p.read_text()[-2000:]}" for p in self.folder.glob("*.log"))

    def start(self, name, *words, **more):
        with open(self.folder / f"{name}.log", "ab") as log:
            self.running[name] = subprocess.Popen([program(words[0]), *words[1:]], env=dict(self.env, **more),
                                                  stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def start_node(self, node):
        self.start(node, "slurmd", "-D", "-N", node, SHEPHERD_NODENAME=node)

    def call(self, *words):
        return subprocess.run(words, env=self.env, capture_output=True, text=True).stdout.strip()

    def kill_daemon(self, node):
        self.running[node].kill()
        self.running[node].wait()

    def kill_node(self, node):
        """The daemon, its shepherds (slurmstepd), and all that they started."""
        self.kill_daemon(node)
        ours = f"SLURM_CONF={self.folder}/slurm.conf\0".encode()
        for pid in filter(str.isdigit, os.listdir("/proc")):
            try:
                if node_of(pid) == node and ours in pathlib.Path(f"/proc/{pid}/environ").read_bytes():
                    os.kill(int(pid), signal.SIGKILL)
            except OSError:
                continue

    def restarts(self, job):
        """How often Slurm began each task of an array anew."""
        told = [dict(w.split("=", 1) for w in line.split() if "=" in w)
                for line in self.call("scontrol", "--oneliner", "show", "job", job).splitlines()]
        return {task["ArrayTaskId"]: int(task["Restarts"]) for task in told}

    def wait_for_end(self, *jobs):
        wait_for(lambda: not self.call("squeue", "-h", "-j", ",".join(jobs)), f"jobs {jobs} end",
                 self.log, 4 * PATIENCE_S)


def program(name):
    return shutil.which(name) or shutil.which(name, path="/usr/sbin:/sbin")


class Store:
    def __init__(self, gieson, folder, env):
        self.gieson, self.folder, self.env = gieson, folder, env

    def words(self, *args):
        return [self.gieson, "--store", str(self.folder), *map(str, args)]

    def run(self, *args):
        done = subprocess.run(self.words(*args), env=self.env, capture_output=True, text=True)
        check(done.returncode == 0, f"gieson {args} ends well: {done.returncode} {done.stdout}{done.stderr}")
        return done.stdout

    def rows(self, sql):
        db = sqlite3.connect(f"file:{self.folder}/gieson.db?mode=ro", uri=True)
        try:
            return db.execute(sql).fetchall()
        finally:
            db.close()

    def working(self, node):
        """(pid, specimen) of the job that a worker of the node has, or None."""
        for pid, name in self.rows("SELECT j.pid, s.name FROM job j JOIN specimen s ON s.id = j.specimen_id "
                                   "WHERE j.state = 'running'"):
            if node_of(pid) == node:
                return pid, name
        return None

    def files(self):
        """All that a reader may see; audit-RUN.json has the times of an audit log in it."""
        return {str(p.relative_to(self.folder)): p.read_bytes() for part in ("reports", "studies")
                for p in (self.folder / part).rglob("*") if p.is_file() and not p.name.startswith("audit-")}


def fill(stores, folder):
    for i in range(COUNT):
        group = ("none", "drug")[i % 2]
        home = folder / f"rat {i}"
        home.mkdir()
        write_volume(home / "v.nrrd", 0.6 - 0.1 * (i % 2) + 0.003 * i)
        job = {"specimen": f"rat {i}", "study": "drawn", "group": group, "kind": "volume", "file": "v.nrrd"}
        if group == "drug":
            job["baseline"] = "none"
        (home / "job.json").write_text(json.dumps(job))
        for store in stores:
            store.run("import", home)


def kill_both(cluster, store):
    """Kills a daemon, then a node while its worker has a job; that job's specimen."""
    kept = wait_for(lambda: store.working("n1"), "a worker on n1")
    cluster.kill_daemon("n1")
    cluster.start_node("n1")
    wait_for(lambda: store.rows("SELECT 1 FROM job j JOIN specimen s ON s.id = j.specimen_id "
                                f"WHERE s.name = '{kept[1]}' AND j.state = 'done'"), "a worker outlives its daemon")
    while True:
        pid, lost = wait_for(lambda: store.working("n2"), "a worker on n2")
        os.kill(pid, signal.SIGSTOP)
        if store.working("n2") == (pid, lost):
            break
        os.kill(pid, signal.SIGCONT)
    cluster.kill_node("n2")
    print(f"n1's daemon was killed: the report of {kept[1]} was made all the same; n2 was killed while it "
          f"computed {lost}", flush=True)
    return kept[1], lost


def main():
    for name in ("slurmctld", "slurmd", "sbatch", "squeue", "scontrol"):
        if not program(name):
            print(f"skipped: {name} is not installed (slurm-wlm)")
            return 77

    with tempfile.TemporaryDirectory(prefix="gieson-slurm-") as place:
        folder = pathlib.Path(place)
        (folder / "cluster").mkdir()
        gieson = str(pathlib.Path(sys.argv[1]) / "gieson")
        cluster = Cluster(folder / "cluster")
        # A name that a shell, or Slurm's own patterns of file names, would take for something else.
        here, there = (Store(gieson, folder / name, cluster.env) for name in ("here", "%A $HOME 'it''s'"))
        fill((here, there), folder)
        local = subprocess.Popen(here.words("night"), stdout=subprocess.PIPE, text=True)
        with cluster:
            jobs = json.loads(there.run("night", "--slurm", "--json"))
            check(jobs["tasks"] == COUNT, f"a task a specimen: {jobs}")
            kept, lost = kill_both(cluster, there)
            restarted = wait_for(lambda: [t for t, n in cluster.restarts(jobs["share"]).items() if n > 0],
                                 "Slurm begins the task of n2 anew", cluster.log)
            check(len(restarted) == 1, f"one task was begun anew: {restarted}")
            print(f"Slurm began task {restarted[0]} anew", flush=True)
            cluster.wait_for_end(jobs["share"], jobs["rest"])
        check(local.wait() == 0, "the night here ends well")

        log = there.folder / "night.log"
        said = log.read_text() if log.exists() else ""
        check((there.folder / "night.txt").exists(), f"the paragraph: {os.listdir(there.folder)} {said}{cluster.log()}")
        words = (there.folder / "night.txt").read_text()
        check(f": {COUNT} specimens computed, {COUNT} reported." in words, f"{words}{said}")
        check(local.stdout.read() == said, f"the log has what the night here prints: {said}")
        claims = dict(there.rows("SELECT s.name, j.claim FROM job j JOIN specimen s ON s.id = j.specimen_id"))
        twice = [name for name, claim in claims.items() if claim > 1]
        check(twice == [lost], f"computed twice: {twice}; killed at work: {lost}, and not: {kept}")
        first, second = here.files(), there.files()
        check(first.keys() == second.keys(), f"the same files: {first.keys() ^ second.keys()}")
        differ = [name for name, content in first.items() if content != second[name]]
        check(not differ, f"every byte is the same: {differ}")
        print(f"{COUNT} specimens, {len(first)} files, {sum(map(len, first.values()))} bytes: the same by Slurm; "
              f"{lost} was computed twice, everything else once")
    return 0


if __name__ == "__main__":
    sys.exit(main())
