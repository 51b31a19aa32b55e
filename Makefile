# make demo   track the packaged example images (installs the core and the figures, no torch)
# make test   run all tests but those of Blender and Ray (installs what they need)
# make lint   ruff and pyright
# make clean  remove the environment and everything generated
#
# The environment is made in .venv by any Python from 3.10 on: PYTHON=python3.12 make test

VENV := .venv
BIN := $(VENV)/bin

.PHONY: help demo test lint clean environment environment-view

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

demo: environment-view
	$(BIN)/twohands demo

test: environment
	@bash scripts/system-packages.sh
	OMP_NUM_THREADS=1 $(BIN)/pytest --numprocesses auto --maxprocesses 4 --ignore tests/training
# The trainer's loader forks, which a process that has held an OpenGL context does not survive: a run of its own.
	OMP_NUM_THREADS=1 $(BIN)/pytest --numprocesses auto --maxprocesses 4 tests/training

lint: environment
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

environment:
	@bash scripts/environment.sh $(VENV) synth,synth-bake,train,datasets,view,video,dev

environment-view:
	@bash scripts/environment.sh $(VENV) view

clean:
	rm -rf $(VENV) build dist out .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
