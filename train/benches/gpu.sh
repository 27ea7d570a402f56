#!/usr/bin/env bash
# Measures training and sampling on a GPU: the paper's denoiser alone (`gpu.rs`), the same in PyTorch if it is installed
# and finds the GPU (`gpu.py`), and the whole chain on the built-in corpus, with the share of time that training waited
# for data. Results are written to FOLDER as JSON lines.
#
#   train/benches/gpu.sh [FOLDER] [DEVICE] [FEATURE]
#
# DEVICE is a name from `stance --device list` (default: wgpu). FEATURE is the feature to build the program with
# (default: vulkan; also wgpu, or cuda if the build can download its kernel compiler). PEAK_TFLOPS is the GPU's peak f32
# throughput from its data sheet. For a machine without a toolchain, copy a target folder built elsewhere and set
# NO_BUILD=1: its programs are then run without building.
set -euo pipefail
cd "$(dirname "$0")/../.."

out=${1:-gpu-results}
device=${2:-wgpu}
feature=${3:-vulkan}
peak=${PEAK_TFLOPS:+--peak $PEAK_TFLOPS}
mkdir -p "$out"

if [ -z "${NO_BUILD:-}" ]; then
  cargo build --release --features "$feature" -p stance
  cargo bench --features "$feature" -p stance -p train --bench gpu --no-run
fi
stance=target/release/stance
bench=$(find target/release/deps -maxdepth 1 -name 'gpu-*' -type f -perm -u+x -printf '%T@ %p\n' | sort -n | tail -1 | cut -d ' ' -f 2)

nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader >"$out/card.txt" 2>/dev/null || true
"$stance" --device list | tee "$out/devices.txt"

echo "== the denoiser, f32"
# shellcheck disable=SC2086
"$bench" "$device" $peak | tee "$out/denoiser.jsonl"
echo "== the denoiser, bf16"
# shellcheck disable=SC2086
"$bench" "$device" $peak --precision bf16 | tee "$out/denoiser-bf16.jsonl" || echo "not measured: the device does not compute in bf16"

echo "== PyTorch"
if python3 -c 'import torch, sys; sys.exit(not torch.cuda.is_available())' 2>/dev/null; then
  python3 train/benches/gpu.py | tee "$out/pytorch.jsonl"
else
  echo "not measured: no PyTorch that sees a card"
fi

echo "== the whole chain on the built-in corpus"
rm -rf "$out/demo"
begun=$SECONDS
"$stance" demo --device "$device" --out "$out/demo"
echo "{\"what\": \"demo\", \"secs\": $((SECONDS - begun))}" | tee "$out/chain.jsonl"
# From the last metrics line of the editor's run: samples per second, and share of time spent waiting for data.
grep '"samples_per_sec"' "$out/demo/runs/motionrefit/metrics.jsonl" | tail -1 | tee -a "$out/chain.jsonl"

echo "== 1,000 items edited"
"$stance" items "$out/demo/dataset" --split test --count 1000 --out "$out/items"
begun=$SECONDS
"$stance" edit "$out/demo/runs/motionrefit" --items "$out/items" --device "$device" --out "$out/edits"
echo "{\"what\": \"items edited\", \"secs\": $((SECONDS - begun))}" | tee -a "$out/chain.jsonl"
