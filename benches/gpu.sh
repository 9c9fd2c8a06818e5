#!/usr/bin/env bash
# What a GPU has to show, in two calls; the machine with the GPU needs neither cargo nor a network.
#
#   benches/gpu.sh pack DIR...                 here: builds, and packs all that the other calls need
#   PACK/gpu.sh run PACK [first|second]        there: measures, each call in less than 9 minutes (without a word: first)
#
# DIR: folders as `marf-labs train` takes them, two at least; one with a transforms_train.json and photos beside it (the
# layout of NeRF's synthetic scenes) gets every tenth photo held out. The first folder is trained twice for one digest.
#
# PACK            folder of the pack, inside the repository and ignored there (target/gpu-pack); 64 MB at most
# OUT             folder of the outcome, at most 8 files (gpu-out)
# GPU             gpu: a real one (default); gpu:NAME: an adapter whose name holds NAME
# TESTS           beginning of the names of the tests that run (gpu::)
# TWICE           steps of the training that is run twice (2000)
# SECONDS_LIST    budgets of the trainings by the clock (10,60)
# VIEWS           folder that keeps the pictures of trainings (none is kept)
# KEYS            keys of those trainings, as `--set` takes them, between blanks ()
# LOADER=pack     takes the Vulkan loader of the pack even where the system has one
set -euo pipefail

fail() { echo "error: $*" >&2; exit 1; }

most_bytes=$((64 << 20))
here=$(dirname "$(realpath "$0")")

# ---- pack

# Copies what the packages of the loader install into lib/: from the system, else from the packages themselves.
pack_loader() {
    local to=$1 package file fetched
    mkdir -p "$to"
    for package in libvulkan1 libegl1 libglvnd0 libopengl0 libgl1 libglx0 libgles2; do
        if dpkg-query -L "$package" >/dev/null 2>&1; then
            dpkg-query -L "$package" | grep '\.so\.' | while read -r file; do cp -a "$file" "$to/"; done
        else
            fetched=$(mktemp -d)
            (cd "$fetched" && apt-get -q download "$package" >/dev/null) || fail "package $package: run apt-get update"
            dpkg -x "$fetched"/*.deb "$fetched/files"
            find "$fetched/files" -name '*.so.*' -exec cp -a {} "$to/" \;
            rm -r "$fetched"
        fi
    done
}

# Copies a scene; one of NeRF's synthetic scenes becomes images/ and transforms.json.
pack_scene() {
    local from=$1 to=$2
    mkdir -p "$to"
    if [ -f "$from/transforms.json" ]; then
        cp -r "$from/images" "$from/transforms.json" "$to/"
    elif [ -f "$from/transforms_train.json" ]; then
        mkdir "$to/images"
        cp "$from"/train/*.png "$to/images/"
        jq '.frames |= (map(.file_path |= "images/" + (split("/") | last) + ".png") | sort_by(.file_path))
            | [.frames[].file_path] as $all
            | .test_filenames = [$all | to_entries[] | select(.key % 10 == 0) | .value]
            | .train_filenames = $all - .test_filenames' "$from/transforms_train.json" > "$to/transforms.json"
    else
        fail "$from has neither transforms.json nor transforms_train.json"
    fi
    chmod -R u+w "$to"
}

# Prints the path of what cargo has built: the last executable of its messages.
built() {
    cargo "$1" --manifest-path "$here/../Cargo.toml" --message-format json "${@:2}" |
        jq -r 'select(.executable != null) | .executable' | tail -n 1
}

pack() {
    [ $# -ge 2 ] || fail "name two folders of photos at least"
    local pack=${PACK:-$here/../target/gpu-pack} build scene bytes
    build=$(mktemp -d)
    mkdir "$build/data"
    strip -o "$build/labs" "$(built build --release -p marf-labs)"
    strip -o "$build/tests" "$(built test --release --config "$here/../tests/checks.toml" --no-run -p marf-field-gpu --lib)"
    pack_loader "$build/lib"
    for scene in "$@"; do pack_scene "$scene" "$build/data/$(basename "$scene")"; done
    basename -a "$@" > "$build/scenes"
    rm -rf "$pack" && mkdir -p "$pack"
    cp "$(realpath "$0")" "$pack/gpu.sh"
    tar -C "$build" -c . | gzip -9 > "$pack/pack.tar.gz"
    rm -r "$build"
    bytes=$(du -sb "$pack" | cut -f 1)
    [ "$bytes" -le $most_bytes ] || fail "$pack has $bytes bytes, $most_bytes at most: leave a folder of photos out"
    echo "$pack: $bytes bytes"
}

# ---- run

# `ldconfig` lies there.
export PATH=$PATH:/usr/sbin:/sbin

# Runs a part of a call for so many seconds at most and notes how it ended; whatever it does, the next part runs.
part() {
    local name=$1 most_s=$2 began=$SECONDS code=0
    shift 2
    echo "== $name"
    timeout --kill-after 5 "$most_s" "$@" || code=$?
    printf '{"part":"%s","exit":%d,"seconds":%d}\n' "$name" "$code" $((SECONDS - began)) >> "$out/$call.jsonl"
}

# Unpacks a pack and finds the driver.
prepare() {
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
    tar -C "$work" -xzf "$1/pack.tar.gz"
    if [ "${LOADER:-}" = pack ] || ! ldconfig -p | grep -q libvulkan.so.1; then
        export LD_LIBRARY_PATH=$work/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
    fi
    local driver=/usr/local/nvidia/share/vulkan/icd.d/nvidia_icd.json
    if ! ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json >/dev/null 2>&1 && [ -f $driver ]; then
        export VK_DRIVER_FILES=$driver
    fi
    export MARF_TEST_GPU=$gpu
}

# What machine this is.
machine() {
    uname -sr
    grep -m 1 'model name' /proc/cpuinfo
    nproc
    nvidia-smi --query-gpu=name,driver_version,memory.total,clocks.max.sm,power.limit --format=csv 2>/dev/null || true
    ldconfig -p | grep -i vulkan || true
    echo "loader: ${LD_LIBRARY_PATH:-of the system}; drivers: ${VK_DRIVER_FILES:-of the system}"
}

# Every module's tests in a process of its own: one that a driver kills takes no other with it.
tests() {
    local module all code=0
    all=$("$work/tests" --list --format terse "${TESTS:-gpu::}" | sed -n 's/: test$//p')
    for module in $(sed 's/::[^:]*$/::/' <<< "$all" | sort -u); do
        # What a driver says goes to stderr and may stand within a line of results.
        timeout 120 "$work/tests" --test-threads 1 --show-output "$module" > "$work/log" 2> "$work/log.err" || code=1
        cat "$work/log" "$work/log.err"
        # Tests that a module shares with one inside it are counted there; those that did not end are missing.
        grep "^$module[^:]*$" <<< "$all" | while read -r test; do
            result=$(sed -n "s/^test $test \.\.\. \([a-zA-Z]*\).*/\1/p" "$work/log" | head -n 1)
            printf '{"test":"%s","result":"%s"}\n' "$test" "${result:-did not end}" >> "$out/tests.jsonl"
        done
    done
    return $code
}

# Trains on a scene of the pack; a line of JSON a budget goes to a file.
train() {
    local scene=$1 to=$2
    shift 2
    "$work/labs" train "$work/data/$scene" --device "$gpu" --out "${VIEWS:-$work/views}/$scene" "$@" |
        sed "s/^{/{\"scene\":\"$scene\",/" >> "$out/$to.jsonl"
}

run() {
    [ $# -ge 1 ] && [ -f "$1/pack.tar.gz" ] || fail "name the folder of a pack"
    call=${2:-first}
    gpu=${GPU:-gpu}
    out=${OUT:-gpu-out}
    mkdir -p "$out"
    out=$(realpath "$out")
    prepare "$(realpath "$1")"
    # The parts are run by `timeout`, which runs programs.
    export -f tests train machine
    export work out gpu
    rm -f "$out/$call.jsonl"
    { "call_$call"; } 2>&1 | tee "$out/$call.log"
}

# 15 + 180 + 2 * 90 s at most.
call_first() {
    local scene
    rm -f "$out/tests.jsonl" "$out/twice.jsonl"
    part machine 15 bash -c machine
    part tests "${TESTS_S:-180}" bash -c tests
    scene=$(head -n 1 "$work/scenes")
    for again in 1 2; do
        part "twice $again" "${TWICE_S:-90}" bash -c "set -o pipefail; train $scene twice --steps ${TWICE:-2000} $(keys)"
    done
}

# 2 * 240 s at most.
call_second() {
    local scene
    rm -f "$out/quality.jsonl"
    part machine 15 bash -c machine
    for scene in $(head -n 2 "$work/scenes"); do
        part "quality $scene" "${QUALITY_S:-240}" \
            bash -c "set -o pipefail; train $scene quality --seconds ${SECONDS_LIST:-10,60} $(keys)"
    done
}

# The keys of trainings as arguments.
keys() {
    local key
    for key in ${KEYS:-}; do printf -- '--set %s ' "$key"; done
}

verb=${1:-}
case $verb in
    pack | run) shift && "$verb" "$@" ;;
    *) fail "pack or run: see the head of $0" ;;
esac
