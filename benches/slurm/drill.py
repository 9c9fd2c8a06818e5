#!/usr/bin/env python3
"""Kills jobs and drivers, and compares digests: `python3 benches/slurm/drill.py MARF DIR [stub|slurm] [PHOTOS]`.

DIR, which must not be there, gets a folder a run. `stub` (the default) is a batch system of this file with two cores; `slurm` is the one
that SLURM_CONF names (`benches/slurm/up.sh`). The drills: a bootstrap of ten on this machine, then with 20 jobs killed at random moments,
then with the driver killed 20 times; a training on machines whose clock is an hour ahead, whose locks do not hold and whose disks are full
(needs faketime, cc and mount, so root); each result of the small demo computed again from an empty folder and the shared store alone; and, for a
folder PHOTOS of many photos, a pull and a run on a fresh machine against a synced copy of the same bytes.
"""

import json
import os
import pathlib
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time

KILLS = 20

PIPELINE = """name = "drill"
[archive.demo]
kind = "demo"
sols = "1"
width = 320
[node.extract]
archive = "demo"
[node.calibrate]
input = "extract"
method = "labels"
[node.train]
input = "calibrate"
steps = {steps}
scale = 2
device = "cpu"
[node.bootstrap]
input = "calibrate"
training = "train"
b = 10
frames = 1
width = 32
device = "cpu"
"""

BIG = """name = "big"
[archive.photos]
kind = "folder"
path = "{photos}"
[node.extract]
archive = "photos"
[node.size]
input = "extract"
"""

SITE = """[executor]
store = "file://{folder}/shared"
folder = "{folder}/jobs"
poll_s = 1
patience_s = 4
cores = 1
memory_mb = 700
"""

COMMANDS = """[executor.commands]
submit = ["{python}", "{root}/submit.py", "{{script}}"]
"""

STUB_COMMANDS = """list = ["{python}", "{root}/stub.py", "list"]
cancel = ["{python}", "{root}/stub.py", "cancel", "{{id}}"]
explain = ["{python}", "{root}/stub.py", "explain", "{{id}}"]
"""

TEMPLATE = """#!/bin/bash
#SBATCH --job-name={{name}}
#SBATCH --output={{log}}
#SBATCH --open-mode=append
#SBATCH {{options}}
exec {before}{{marf}} exec {{action}} --store {{store}} --result {{result}} --scratch {{scratch}} --threads {{cores}}
"""

# Every lock is granted at once.
NO_LOCKS = """#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdarg.h>
int flock(int file, int how) { return 0; }
static int without(int file, int what, void *more) {
    if (what == F_SETLK || what == F_SETLKW || what == F_OFD_SETLK || what == F_OFD_SETLKW) return 0;
    return ((int (*)(int, int, void *))dlsym(RTLD_NEXT, "fcntl"))(file, what, more);
}
int fcntl(int file, int what, ...) {
    va_list words; va_start(words, what); void *more = va_arg(words, void *); va_end(words);
    return without(file, what, more);
}
int fcntl64(int file, int what, ...) {
    va_list words; va_start(words, what); void *more = va_arg(words, void *); va_end(words);
    return without(file, what, more);
}
"""

# Notes each submission, so that they can be counted.
SUBMIT = """import os, re, subprocess, sys
script = sys.argv[1]
name = re.search("--job-name=(.*)", open(script).read())[1]
ran = subprocess.run({submit} + [script], stdout=subprocess.PIPE, text=True)
if ran.returncode == 0:
    with open({notes!r}, "a") as notes:
        notes.write(name + chr(10))
print(ran.stdout, end="")
sys.exit(ran.returncode)
"""

STUB = """import fcntl, os, pathlib, re, signal, subprocess, sys, time
jobs = pathlib.Path(__file__).with_name("stub")
verb = sys.argv[1]
if verb == "submit":
    jobs.mkdir(exist_ok=True)
    text = open(sys.argv[2]).read()
    job = str(time.time_ns())
    words = [re.search(word + "=(.*)", text)[1] for word in ("--job-name", "--output")]
    (jobs / job).write_text(words[0] + "|PENDING|Resources")
    subprocess.Popen([sys.executable, __file__, "run", job, sys.argv[2], *words], start_new_session=True,
                     stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    print(job)
elif verb == "run":
    job, script, name, log = sys.argv[2:]
    core, cores = None, [open(jobs.with_name("core%d" % core), "w") for core in (0, 1)]
    while core is None:
        for one in cores:
            try:
                fcntl.flock(one, fcntl.LOCK_EX | fcntl.LOCK_NB)
                core = one
                break
            except OSError:
                pass
        time.sleep(0.05)
    if (jobs / job).exists():
        child = subprocess.Popen(["bash", script], stdout=open(log, "a"), stderr=subprocess.STDOUT, start_new_session=True)
        (jobs / job).write_text(name + "|RUNNING|None|" + str(child.pid))
        child.wait()
        (jobs / job).unlink(missing_ok=True)
elif verb == "list":
    for job in sorted(jobs.glob("*")):
        try:
            print(job.name + "|" + "|".join(job.read_text().split("|")[:3]))
        except OSError:
            pass
elif verb == "cancel":
    try:
        words = (jobs / sys.argv[2]).read_text().split("|")
        (jobs / sys.argv[2]).unlink()
        if len(words) == 4:
            os.killpg(int(words[3]), signal.SIGTERM)
    except OSError:
        pass
else:
    print("JobState=FAILED Reason=NonZeroExitCode ExitCode=0:9")
"""


class Drill:
    """The batch system and the folders of runs."""

    def __init__(self, marf, root, kind):
        self.marf, self.root, self.kind = marf, root, kind
        self.failures = []
        root.mkdir(parents=True)
        (root / "stub.py").write_text(STUB)
        submit = ["sbatch", "--parsable"] if kind == "slurm" else [sys.executable, str(root / "stub.py"), "submit"]
        (root / "submit.py").write_text(SUBMIT.format(submit=submit, notes=str(root / "submitted")))

    def folder(self, name, pipeline, of=None):
        """A folder with a pipeline and a site, with the store of another one where `of` names it."""
        made = self.root / name
        made.mkdir()
        (made / "pipeline.toml").write_text(pipeline)
        words = {"folder": made, "root": self.root, "python": sys.executable}
        commands = COMMANDS if self.kind == "slurm" else COMMANDS + STUB_COMMANDS
        (made / "site.toml").write_text((SITE + commands).format(**words))
        if of:
            shutil.copytree(self.root / of / ".marf", made / ".marf", symlinks=True)
        return made

    def run(self, folder, *words, log=None, environment=None):
        """Runs marf to its end; returns what it printed and its seconds of wall and CPU."""
        before, began = os.times(), time.monotonic()
        ran = subprocess.run(
            [self.marf, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        after, wall = os.times(), time.monotonic() - began
        if log:
            log.write_text(ran.stderr + ran.stdout)
        if ran.returncode:
            sys.exit(f"marf {' '.join(map(str, words))}: {ran.returncode}: {ran.stdout}{ran.stderr}")
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        return ran.stdout, wall, cpu

    def digests(self, folder):
        """The digests of all outputs of the last run, by node and name."""
        status = json.loads(self.run(folder, "status", "--json")[0])
        return {
            f"{node['name']} {name}": output["digest"]
            for node in status["nodes"]
            for name, output in node["outputs"].items()
        }

    def expect(self, holds, told):
        """Notes what did not hold."""
        if not holds:
            self.failures.append(told)

    def submitted(self):
        """Takes the names of the jobs that were submitted since the last call."""
        notes = self.root / "submitted"
        names = notes.read_text().split() if notes.exists() else []
        notes.unlink(missing_ok=True)
        return names


def running_jobs(folder):
    """Process numbers of `marf exec` of a folder, each with the key of its action."""
    found = {}
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        if "exec" in words[1:2] and words[2].startswith(str(folder)):
            found[int(process.name)] = re.search("[0-9a-f]{64}", words[2])[0]
    return found


def kill_jobs(folder, stop, killed):
    """Kills jobs of a folder with SIGKILL at random moments, at most two of a key, until `KILLS` are dead."""
    due = {}
    while not stop.is_set() and len(killed) < KILLS:
        for process, key in running_jobs(folder).items():
            due.setdefault(process, time.monotonic() + random.uniform(0, 2))
            if time.monotonic() >= due[process] and killed.count(key) < 2 and len(killed) < KILLS:
                try:
                    os.kill(process, signal.SIGKILL)
                except ProcessLookupError:
                    continue
                killed.append(key)
                due[process] = float("inf")
                print(f"  killed {process} of {key[:12]}", flush=True)
        time.sleep(0.05)


def drill_jobs(drill, expected):
    folder = drill.folder("kills", PIPELINE.format(steps=300))
    stop, killed = threading.Event(), []
    killer = threading.Thread(target=kill_jobs, args=(folder, stop, killed))
    killer.start()
    _, wall, cpu = drill.run(folder, "run", "--on", "slurm", log=drill.root / "kills.log")
    stop.set()
    killer.join()
    found, jobs = drill.digests(folder), drill.submitted()
    equal = sum(expected[name] == found.get(name) for name in expected)
    print(f"{len(killed)} jobs killed: {wall:.0f} s, {cpu:.0f} s of CPU, {len(jobs)} jobs, {equal} of {len(expected)} outputs equal", flush=True)
    drill.expect(equal == len(expected), "outputs differ after jobs were killed")


def drill_driver(drill):
    expected = drill.folder("local600", PIPELINE.format(steps=600))
    drill.run(expected, "run", "--to", "bootstrap")
    folder = drill.folder("drivers", PIPELINE.format(steps=600))
    began = time.monotonic()
    for _ in range(KILLS):
        driver = subprocess.Popen([drill.marf, "run", "--on", "slurm"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(random.uniform(0.3, 5))
        driver.kill()
        driver.wait()
    killing = time.monotonic() - began
    _, wall, cpu = drill.run(folder, "run", "--on", "slurm", log=drill.root / "drivers.log")
    expected, found, jobs = drill.digests(expected), drill.digests(folder), drill.submitted()
    equal = sum(expected[name] == found.get(name) for name in expected)
    print(
        f"driver killed {KILLS} times: {killing:.0f} s + {wall:.0f} s ({cpu:.0f} s of CPU), {len(jobs)} jobs of {len(set(jobs))} actions, "
        f"{equal} of {len(expected)} outputs equal",
        flush=True,
    )
    drill.expect(equal == len(expected), "outputs differ after the driver was killed")
    drill.expect(len(jobs) == len(set(jobs)), "a job was submitted twice")


def drill_hosts(drill, expected):
    """A training on machines that are not as they should be; `expected` are the outputs of one that is."""
    expected = {name: digest for name, digest in expected.items() if name.startswith("train ")}
    shim = drill.root / "no_locks.so"
    (drill.root / "no_locks.c").write_text(NO_LOCKS)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", shim, drill.root / "no_locks.c", "-ldl"], check=True)

    def prepared(name, before=""):
        folder = drill.folder(name, PIPELINE.format(steps=300))
        (folder / "job.sh").write_text(TEMPLATE.format(before=before))
        site = (folder / "site.toml").read_text()
        (folder / "site.toml").write_text(site.replace("[executor]", f'[executor]\ntemplate = "{folder}/job.sh"', 1))
        return folder

    def compared(name, folder, environment=None):
        drill.run(folder, "run", "--on", "slurm", "--to", "train", environment=environment)
        found = drill.digests(folder)
        equal = sum(digest == found.get(output) for output, digest in expected.items())
        print(f"{name}: {equal} of {len(expected)} outputs equal", flush=True)
        drill.expect(equal == len(expected), f"{name}: outputs differ")

    def refused(name, folder, full):
        """With a full disk at `full` the run ends with one error; with a disk that has room, the next one gives the outputs."""
        full.mkdir(parents=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", full], check=True)
        try:
            words = [drill.marf, "run", "--on", "slurm", "--to", "train"]
            ran = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        finally:
            subprocess.run(["umount", "-l", full], check=True)
        told = ran.stderr[ran.stderr.rfind("error:") :].strip()
        print(f"{name}: exit code {ran.returncode}: {told}", flush=True)
        drill.expect(ran.returncode == 1 and "No space left" in told, f"{name}: {told}")
        compared(f"{name}, then with room", folder)

    compared("clocks of jobs an hour ahead", prepared("ahead", "faketime -f +1h "))
    compared("clocks of jobs an hour behind", prepared("behind", "faketime -f -1h "))
    without = {**os.environ, "LD_PRELOAD": str(shim)}
    compared("locks that do not hold, at the driver and at jobs", prepared("locks", f"env LD_PRELOAD={shim} "), without)
    folder = prepared("scratch")
    refused("a full disk for scripts, results and scratch", folder, folder / "jobs")
    folder = prepared("shared")
    refused("a full disk for the shared store", folder, folder / "shared")


def drill_exec(drill):
    """Each node of the small demo. Parts of nodes and what reads an archive are refused."""
    folder = drill.root / "demo"
    folder.mkdir()
    drill.run(folder, "init")
    sets = pathlib.Path(__file__).parents[2] / "tests" / "common" / "mod.rs"
    small = re.search(r"SMALL_DEMO[^=]*= \[(.*?)\];", sets.read_text(), re.DOTALL)[1]
    drill.run(folder, "run", *[word for one in re.findall('"(.*?)"', small) for word in ("--set", one)])
    store = f"file://{folder}/shared"
    drill.run(folder, "cache", "push", "--remote", store)
    records = folder / "shared" / "records"
    keys = sorted(record.parent.name + record.name for record in records.glob("*/*"))
    print(f"the demo has {len(keys)} results", flush=True)
    made, parts, archives = 0, 0, 0
    for key in keys:
        with tempfile.TemporaryDirectory() as empty:
            words = [drill.marf, "exec", key, "--store", store, "--result", f"{empty}/result.json"]
            ran = subprocess.run(words, cwd=empty, capture_output=True, text=True, check=False)
        if ran.returncode == 10 and "which reads an archive" in ran.stderr:
            archives += 1
        elif ran.returncode == 10 and "computes only with its node" in ran.stderr:
            parts += 1
        elif ran.returncode or "another result" in ran.stderr:
            print(f"  {key[:12]}: {ran.returncode}: {ran.stderr.strip()}", flush=True)
            drill.expect(False, f"{key} was not made again")
        else:
            made += 1
    print(f"{made} of {len(keys)} actions computed again, with the same digests; {parts} parts and {archives} that read an archive are refused", flush=True)


def drill_pull(drill, photos):
    big = drill.folder("big", BIG.format(photos=photos))
    drill.run(big, "run")
    store = f"file://{big}/shared"
    drill.run(big, "cache", "push", "--remote", store)
    subprocess.run(["sync", "-f", big], check=True)
    ratios = []
    # Nothing is removed between: a file system that has just freed as many pages writes both faster, as no fresh machine does.
    for turn in range(5):
        copy = drill.root / f"copy{turn}"
        began = time.monotonic()
        subprocess.run(["cp", "-r", big / "shared", copy], check=True)
        subprocess.run(["sync", "-f", copy], check=True)
        copied = time.monotonic() - began
        fresh = drill.folder(f"fresh{turn}", BIG.format(photos=photos))
        _, pulled, _ = drill.run(fresh, "cache", "pull", "--remote", store)
        told, ran, _ = drill.run(fresh, "run")
        drill.expect(told.strip().splitlines()[-1].startswith("0 of "), told)
        ratios.append((pulled + ran) / copied)
        print(f"  copy {copied:.2f} s, pull {pulled:.2f} s, run {ran:.2f} s: {told.strip().splitlines()[-1]}", flush=True)
    told = ", ".join(f"{ratio:.2f}" for ratio in sorted(ratios))
    print(f"pull and run against copy: {told}", flush=True)


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    marf, root = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
    drill = Drill(marf, root, sys.argv[3] if len(sys.argv) > 3 else "stub")
    local = drill.folder("local", PIPELINE.format(steps=300))
    _, wall, cpu = drill.run(local, "run")
    expected = drill.digests(local)
    print(f"this machine: {wall:.0f} s, {cpu:.0f} s of CPU, {len(expected)} outputs", flush=True)
    drill_jobs(drill, expected)
    drill_driver(drill)
    drill_hosts(drill, expected)
    drill_exec(drill)
    if len(sys.argv) > 4:
        drill_pull(drill, pathlib.Path(sys.argv[4]).resolve())
    if drill.failures:
        sys.exit("\n".join(drill.failures))


if __name__ == "__main__":
    main()
