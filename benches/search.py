#!/usr/bin/env python3
"""Is the field that `marf fit --budget` chooses as good as the best that a random search finds?

    benches/search.py MARF DIR BUDGET COUNT JUDGED_SCALE OUT

Trains once as it is and COUNT times with random values of the keys below, each for BUDGET (`60s`), one after the other, and writes a
line of JSON each to OUT: keys, PSNR and SSIM of the photos held out, steps. A search that was stopped goes on. Nothing else may run.
"""

import json
import pathlib
import random
import subprocess
import sys
import tempfile

KEYS = {
    "scale": [1, 2, 3],
    "field.batch_samples": [1 << 14, 1 << 15, 1 << 16, 1 << 17],
    "field.log2_table_shift": [-2, -1, 0, 1, 2],
    "field.finest_factor": [0.5, 0.7, 1.0, 1.4],
    "field.learning_rate": [0.005, 0.01, 0.02, 0.04],
    "field.color_width": [16, 32, 64],
    "field.density_width": [16, 32, 64],
    "field.features": [2, 4],
    "field.view_dependence": ['"on"', '"off"'],
}


def main() -> None:
    marf, photos, budget, count, judged_scale, out = sys.argv[1:]
    out = pathlib.Path(out)
    known = [json.loads(line)["keys"] for line in out.read_text().splitlines()] if out.exists() else []
    draw = random.Random(0)
    draws = [{}] + [{key: draw.choice(values) for key, values in KEYS.items()} for _ in range(int(count))]
    for keys in draws:
        if keys in known:
            continue
        # A number of photos to judge, more than there are: all that are held out, and none of those trained on.
        judged = {"judged_scale": int(judged_scale), "judged_photos": 1000}
        fitted = fit(marf, photos, budget, {**keys, **judged})
        line = json.dumps({"keys": keys, **fitted})
        print(line, flush=True)
        with out.open("a") as file:
            file.write(line + "\n")


def fit(marf: str, photos: str, budget: str, keys: dict) -> dict:
    """Returns what one training has; its error where it is refused."""
    sets = [part for key, value in keys.items() for part in ("--set", f"train.{key}={value}")]
    with tempfile.TemporaryDirectory() as folder:
        command = [marf, "fit", photos, "--budget", budget, "--store", f"{folder}/store", "--out", f"{folder}/out", "--json", *sets]
        ran = subprocess.run(command, capture_output=True, text=True)
    if ran.returncode != 0:
        # Drivers of GPUs complain before.
        errors = [line for line in ran.stderr.splitlines() if line.startswith("error: ")]
        if not errors:
            sys.exit(f"{' '.join(command)} ended with {ran.returncode} and no error:\n{ran.stderr}")
        return {"refused": errors[-1]}
    (fitted,) = json.loads(ran.stdout).values()
    return {key: fitted[key] for key in ("psnr", "ssim", "steps", "train_seconds", "peak_mb")}


main()
