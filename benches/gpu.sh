#!/usr/bin/env bash
# What a GPU has to show: every kernel against its CPU twin, their times, whole trainings.
#
#   benches/gpu.sh DIR...    folders with images/ and transforms.json, as `marf bench train` takes them
#
# GPU            gpu: a real one (default); gpu:NAME: an adapter whose name holds NAME
# SECONDS_LIST   budgets of the trainings (10,60,300)
# OUT            folder for all that is printed and rendered (gpu-bench)
set -euo pipefail

gpu=${GPU:-gpu}
out=${OUT:-gpu-bench}
mkdir -p "$out"
repository=$(dirname "$(dirname "$(realpath "$0")")")
in_repository() { cargo "$1" --manifest-path "$repository/Cargo.toml" "${@:2}"; }

# 1. Right: a test that fails ends the script. The figures it prints go into benches/gpu.md.
MARF_TEST_GPU=$gpu in_repository test --release -p marf-field --lib gpu:: -- --nocapture --test-threads=1 \
    2>&1 | tee "$out/kernels.txt"

# 2. Fast: kernels beside the ceilings of the device.
MARF_BENCH_GPU=$gpu in_repository bench -p marf-field --bench gpu 2>&1 | tee "$out/bench.txt"

# 3. Useful: PSNR by the clock, a JSON line a budget.
for scene in "$@"; do
    name=$(basename "$scene")
    in_repository run --release --quiet -p marf -- bench train "$scene" --device "$gpu" \
        --seconds "${SECONDS_LIST:-10,60,300}" --out "$out/$name" | tee "$out/$name.jsonl"
done
