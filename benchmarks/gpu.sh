#!/usr/bin/env bash
# What only a machine with an NVIDIA card can tell, in about ten minutes: doctor, the tests on a card, the rates of
# docs/performance.md, a sweep that is killed and resumed, and with the time that is left real runs of the paper's size.
#
#     benchmarks/gpu.sh [FOLDER]     PYTHON: the interpreter; MINUTES: for all of it
set -u
cd "$(dirname "$0")/.."
out=$(realpath -m "${1:-gpu}")
python=${PYTHON:-python}
minutes=${MINUTES:-10}
rrmctl() { "$python" -m rrmctl "$@"; }
left() { echo $((minutes * 60 - SECONDS)); }
say() { echo; echo "== [$SECONDS s] $*"; }
mkdir -p "$out"
failed=0

say doctor
rrmctl doctor 2>&1 | grep -iE "card|driver|rendering|cores"

say the tests on a card
timeout "$(left)" "$python" -m pytest -p no:cacheprovider -W ignore -n 8 -rf --tb=short tests/rrm/test_cuda.py 2>&1 | tail -n 60
[ "${PIPESTATUS[0]}" = 0 ] || failed=1

say rates
timeout "$(left)" "$python" -m benchmarks cards --json "$out/cards.json" 2>&1 || failed=1

say a sweep that is killed and resumed, beside one that is not
sweep=(quickstart --methods oracle,rrm-proxy --seeds 1 --set steps=6000 --device "${DEVICE:-cuda}")
rrmctl run "${sweep[@]}" --results "$out/whole" --yes >"$out/whole.log" 2>&1 &
whole=$!
rrmctl run "${sweep[@]}" --results "$out/killed" --yes >"$out/killed.log" 2>&1 &
killed=$!
sleep "${KILL_AFTER:-12}"
pkill -KILL -f "rrmctl[a-z._ ]*(run|worker).*$out/killed"
wait "$killed"
rrmctl status --results "$out/killed" 2>&1 | tail -n 4
rrmctl resume --results "$out/killed" 2>&1 | tail -n 3
wait "$whole"
"$python" - "$out/whole" "$out/killed" <<'PYTHON' || failed=1
import sys
from pathlib import Path

import pyarrow.parquet as pq

whole, killed = (sorted(Path(root).glob("runs/*/curve.parquet")) for root in sys.argv[1:])
assert whole, "no run has a curve"
for one, other in zip(whole, killed, strict=True):
    clock = {"wall_s", "steps_per_s"}
    a, b = (pq.read_table(path).drop_columns(sorted(clock)) for path in (one, other))
    assert a.equals(b) or a.to_pandas().equals(b.to_pandas()), f"{one.parent.name}: the curves differ"
print(f"{len(whole)} runs, killed and resumed: equal to their twins")
PYTHON

if [ "$(left)" -gt 60 ]; then
	say "the paper's own scale, as far as it gets"
	mps=(); command -v nvidia-cuda-mps-control >/dev/null && mps=(--mps)
	timeout --signal=INT --kill-after=30 $(($(left) - 30)) "$python" -m rrmctl run main-results --tasks button-press \
		--methods pebble,rrm-proxy --profile paper --seeds "${SEEDS:-8}" --device "${DEVICE:-cuda}" "${mps[@]}" \
		--per-gpu "${PER_GPU:-16}" --results "$out/paper" --yes 2>&1 | tail -n 30
	rrmctl status --results "$out/paper" 2>&1 | tail -n 30
fi
say "ended with $failed"
exit "$failed"
