#!/bin/sh
# Train both networks on the project's CMU clips, as the weights that the package ships were, and export them.
# Usage: scripts/train_weights.sh RUNS_FOLDER; run again it goes on where it stopped.
set -eu
runs=${1:?"usage: scripts/train_weights.sh RUNS_FOLDER"}
here=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$runs"
# train NETWORK NAME OPTION...: the run NAME, its weights and its log as a picture.
train() {
    network=$1 name=$2
    shift 2
    "$here/.venv/bin/python" -m poser train "$network" -o "$runs/$name" "$@" \
        --export "$runs/$name.safetensors" --plot "$runs/$name.png"
}
train dip dip-begun --steps 2000 --batch 64 --frames 40 --rate 1e-3 --cooldown 0.35 --every 250
train dip dip-more --start "$runs/dip-begun.safetensors" \
    --steps 1600 --batch 64 --frames 40 --rate 7e-4 --cooldown 0.5 --every 100
train dip dip --start "$runs/dip-more.safetensors" \
    --steps 3450 --batch 64 --frames 40 --rate 1e-3 --cooldown 0.4 --every 100
train imuposer imuposer-begun --steps 2400 --batch 32 --frames 125 --rate 1e-3 --cooldown 0.35 --every 200
train imuposer imuposer --start "$runs/imuposer-begun.safetensors" \
    --steps 1700 --batch 32 --frames 125 --rate 1e-3 --cooldown 0.4 --every 100
echo "Copy dip.* and imuposer.* (.safetensors, .json, .md) to learned/weights/ if they beat the shipped ones on validation."
