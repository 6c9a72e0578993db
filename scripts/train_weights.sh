#!/bin/sh
# Train both networks on the project's split and export the weights that the package ships.
# Usage: scripts/train_weights.sh RUNS_FOLDER [MINUTES_EACH]; run again it goes on where it stopped.
set -eu
runs=${1:?"usage: scripts/train_weights.sh RUNS_FOLDER [MINUTES_EACH]"}
minutes=${2:-600}
here=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$runs"
for network in dip imuposer; do
    "$here/.venv/bin/python" -m poser train "$network" -o "$runs/$network" --minutes "$minutes" \
        --export "$runs/$network.safetensors" --plot "$runs/$network.png"
done
echo "Copy the .safetensors, .json and .md to learned/weights/ if they beat the shipped ones on validation."
