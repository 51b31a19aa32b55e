# make demo   track the packaged example images (installs the core and the figures, no torch)
# make test   run all tests but those of Blender and Ray (installs what they need)
# make test-fast  the tests of mathematics, models, decisions, scores and pages: a minute on two idle cores
# make lint   ruff and pyright
# make clean  remove the environment and everything generated
#
# The environment is made in .venv by any Python from 3.10 on: PYTHON=python3.12 make test

VENV := .venv
BIN := $(VENV)/bin
# Neighbours share fixtures, and so are done by the same process; one that has no more to do takes half of another's.
SHARED_OUT := --numprocesses auto --maxprocesses 4 --dist worksteal

.PHONY: help demo test test-fast lint clean environment environment-view

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

demo: environment-view
	$(BIN)/twohands demo

test: environment
	@bash scripts/system-packages.sh
	OMP_NUM_THREADS=1 $(BIN)/pytest $(SHARED_OUT) --ignore tests/training
# The trainer's loader forks, which a process that has held an OpenGL context does not survive: a run of its own.
	OMP_NUM_THREADS=1 $(BIN)/pytest $(SHARED_OUT) tests/training

# What renders nothing, trains nothing and runs no shipped weights; add new files by that rule. A minute of processor time.
FAST := tests/geometry tests/formats tests/lifting tests/models tests/datasets/inspection \
	$(addprefix tests/evaluation/test_,metrics.py comparison.py protocols.py importing.py results.py) \
	$(addprefix tests/inference/test_,clip_files.py handedness.py keypoints.py leaving.py placement.py records.py \
	runtime.py tracker.py views.py) \
	tests/executors/test_base.py tests/batch/test_stores.py \
	$(addprefix tests/live/test_,clip.py door.py messages.py) tests/visualization/test_view_page.py \
	$(addprefix tests/motion/test_,bvh.py clip.py even_times.py fit.py openxr.py) \
	$(addprefix tests/training/test_,losses.py schedule.py) \
	$(addprefix tests/test_,architecture.py files.py pages.py plausibility.py skeleton.py)

test-fast: environment
	OMP_NUM_THREADS=1 $(BIN)/pytest --quiet --numprocesses 2 --dist worksteal -m "not slow" $(FAST)

lint: environment
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

environment:
	@bash scripts/environment.sh $(VENV) synth,synth-bake,train,datasets,view,video,live,motion,remote,heic,dev

environment-view:
	@bash scripts/environment.sh $(VENV) view

clean:
	rm -rf $(VENV) build dist out .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
