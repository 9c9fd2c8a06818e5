#!/usr/bin/env python3
"""Asks a running `marf view` for the distances of pairs of points whose true distance is known.

    cargo run --release -p marf-labs -- true-pairs out/train/scene.json 100 5 > pairs.jsonl
    marf view --port 8460 &
    python3 benches/distances.py http://127.0.0.1:8460/ RUN pairs.jsonl

Prints a JSON object: median and 90th percentile of |error| / true distance, the share of pairs whose 90 % interval holds the truth, the
median of half an interval over the distance, and pairs without a surface or an interval. Only the standard library of Python is needed.
"""
import json
import sys
import urllib.error
import urllib.request


def asked(address, body):
    """Returns an answer, or None where the field has no surface."""
    origin = address.rstrip("/")
    request = urllib.request.Request(origin + "/distance", json.dumps(body).encode(), {"Origin": origin})
    try:
        with urllib.request.urlopen(request) as answer:
            return json.load(answer)
    except urllib.error.HTTPError as error:
        if error.code == 422:
            return None
        raise SystemExit(f"{error.code}: {error.read().decode()}")


def main():
    address, run, file = sys.argv[1:4]
    with urllib.request.urlopen(f"{address.rstrip('/')}/scene/{run}/0") as scene:
        scale = json.load(scene)["metres_per_unit"]
    errors, widths, held, missing, open_ended = [], [], [], 0, 0
    for line in open(file):
        pair = json.loads(line)
        view = {key: pair[key] for key in ("camera", "cam_from_world")}
        marks = [dict(view, pixel=pixel) for pixel in pair["pixels"]]
        found = asked(address, {"run": int(run), "field": 0, "marks": marks})
        if found is None:
            missing += 1
            continue
        truth = pair["true_m"]
        errors.append(abs(found["length"] * scale - truth) / truth)
        if found["interval"] is None:
            open_ended += 1
            continue
        low, high = (end * scale for end in found["interval"])
        held.append(low <= truth <= high)
        widths.append((high - low) / 2 / truth)
    quantile = lambda values, share: sorted(values)[min(len(values) - 1, int(share * len(values)))]
    print(json.dumps({
        "pairs": len(errors), "no_surface": missing, "no_interval": open_ended,
        "median_error": round(quantile(errors, 0.5), 4), "p90_error": round(quantile(errors, 0.9), 4),
        "interval_holds": round(sum(held) / len(held), 3) if held else None,
        "median_half_width": round(quantile(widths, 0.5), 4) if widths else None,
    }))


main()
