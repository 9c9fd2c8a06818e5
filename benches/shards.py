#!/usr/bin/env python3
"""What a driver takes for many shards: `python3 benches/shards.py MARF DIR [SHARDS] [PHOTOS_PER_TASK] [DRIVER_PHOTOS]`.

DIR gets a folder with a small photo a sol, a run that reads them, and a shared store. Then a machine that has pulled the run has all
photos measured by a batch system twice: first by jobs that measure (PHOTOS_PER_TASK photos a job), which fills the shared store; then,
with the shared store as it was before, by a batch system that computes nothing: it puts the results of the first time there and tells
that each job is done. So the second run is the driver's work alone, DRIVER_PHOTOS photos a job. Prints its CPU, memory and time.
"""

import os
import pathlib
import shutil
import struct
import subprocess
import sys
import time
import zlib

PIPELINE = """name = "shards"
[archive.photos]
kind = "folder"
path = "{photos}"
[node.extract]
archive = "photos"
[node.grayscale]
input = "extract"
"""

SITE = """[executor]
store = "file://{dir}/shared"
folder = "{dir}/jobs"
poll_s = 1
patience_s = 3000
cores = 2
photos_per_task = {photos}
[executor.commands]
submit = ["python3", "{stub}", "submit", "{{script}}"]
list = ["true"]
cancel = ["true"]
explain = ["true"]
"""

# A submission leaves a process behind, which runs the job, or puts its results in place: so what the jobs take is no part of what the
# driver takes.
STUB = """import json, os, pathlib, subprocess, sys
verb, script = sys.argv[1], pathlib.Path(sys.argv[2])
if verb == "submit":
    left = subprocess.Popen([sys.executable, __file__, "run", script], start_new_session=True, stdout=subprocess.DEVNULL)
    print(left.pid)
    sys.stdout.flush()
    os._exit(0)
here = pathlib.Path(__file__).parent
if (here / "filled").exists():
    if not (here / "shared/copied").exists():
        subprocess.run(["cp", "-rn", f"{here}/filled/.", f"{here}/shared/"], check=True)
        (here / "shared/copied").touch()
    written = script.with_suffix(".tmp")
    written.write_text(json.dumps({"key": script.stem, "program": "stub"}))
    os.rename(written, script.with_suffix(".json"))
else:
    subprocess.run(["bash", script], check=True)
"""


def png(number):
    """A picture of 8 x 8 pixels that no other number has."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    noise = [(number * 2654435761 + at * 40503) >> 7 & 255 for at in range(192)]
    rows = b"".join(b"\0" + bytes(noise[at : at + 24]) for at in range(0, 192, 24))
    header = struct.pack(">IIBBBBB", 8, 8, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def name(number):
    """The name of a product of Mars 2020, sol 0 to 9999."""
    return f"NLF_{number:04}_{667000000 + number:010}_000ECM_N0030000NCAM00501_01_295J01.png"


def main():
    marf, root = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
    shards = int(sys.argv[3]) if len(sys.argv) > 3 else 10_000
    photos = int(sys.argv[4]) if len(sys.argv) > 4 else 1_000
    of_driver = int(sys.argv[5]) if len(sys.argv) > 5 else 100
    (root / "photos").mkdir(parents=True)
    for number in range(shards):
        (root / "photos" / name(number)).write_bytes(png(number))

    def folder(which, photos_per_task):
        made = root / which
        made.mkdir()
        (made / "pipeline.toml").write_text(PIPELINE.format(photos=root / "photos"))
        text = SITE.format(dir=root, photos=photos_per_task, stub=root / "stub.py")
        (made / "site.toml").write_text(text)
        return made

    def run(which, *words):
        began = time.monotonic()
        timed = ["/usr/bin/time", "-f", "%U %S %M", marf, *words]
        ran = subprocess.run(timed, cwd=root / which, capture_output=True, text=True, check=False)
        if ran.returncode:
            sys.exit(f"{words}: {ran.stdout}{ran.stderr}")
        user, system, kib = map(float, ran.stderr.split()[-3:])
        took = f"{time.monotonic() - began:.1f} s, {user:.1f} + {system:.1f} s of CPU, {kib / 1024:.0f} MB"
        print(f"{which}: marf {' '.join(words)}: {took}", flush=True)
        return ran

    store = f"file://{root}/shared"
    (root / "stub.py").write_text(STUB)
    folder("reader", photos)
    run("reader", "run", "--to", "extract")
    run("reader", "cache", "push", "--remote", store)
    shutil.copytree(root / "shared", root / "before")
    folder("measurer", photos)
    run("measurer", "cache", "pull", "--remote", store)
    folder("driver", of_driver)
    shutil.copytree(root / "measurer" / ".marf", root / "driver" / ".marf", symlinks=True)
    run("measurer", "run", "--on", "slurm")
    os.rename(root / "shared", root / "filled")
    shutil.copytree(root / "before", root / "shared")
    print(run("driver", "run", "--on", "slurm").stdout)


if __name__ == "__main__":
    main()
