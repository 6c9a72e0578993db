#!/bin/sh
# Train both networks on the project's CMU clips, as the weights that the package ships were, and export them.
# Usage: scripts/train_weights.sh RUNS_FOLDER; run again it goes on where it stopped.
set -eu
runs=${1:?"usage: scripts/train_weights.sh RUNS_FOLDER"}
here=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$runs"
train() {
    network=$1
    shift
    "$here/.venv/bin/python" -m poser train "$network" -o "$runs/$network" "$@" \
        --export "$runs/$network.safetensors" --plot "$runs/$network.png"
}
train dip --steps 2000 --batch 64 --frames 40 --rate 1e-3 --cooldown 0.35 --every 250
train imuposer --steps 2400 --batch 32 --frames 125 --rate 1e-3 --cooldown 0.35 --every 200
echo "Copy the .safetensors, .json and .md to learned/weights/ if they beat the shipped ones on validation."
