# Each command sets up .venv from the lock first, if that is needed.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-quick test-faults test-net check bench bench-px4 bench-net figures golden golden-recordings lock clean

demo: .venv/.ready
	$(BIN)/clew demo

test: .venv/.ready
	$(BIN)/python -m pytest --numprocesses=auto --no-loadscope-reorder

# Without the campaign of faults and the studies of the method, which take most of the time.
test-quick: .venv/.ready
	$(BIN)/python -m pytest -m "not slow and not net and not faults" --numprocesses=auto --no-loadscope-reorder

# Real processes broken in flight, one flight after the other, some of them (as root) on two hosts; and flights in which
# nothing breaks and nothing may alarm.
test-faults: .venv/.ready
	$(BIN)/python -m pytest -m faults tests

# Needs root: two network namespaces with a bad radio between them. The flights over it are in test-faults.
test-net: .venv/.ready
	$(BIN)/python -m pytest -m "net and not faults" tests/net

check: .venv/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

bench: .venv/.ready
	$(BIN)/python -m benchmarks

# On real PX4 in software; PX4_BIN is its program.
bench-px4: .venv/.ready
	$(BIN)/python -m benchmarks.px4

# Needs root, and the machine to itself.
bench-net: .venv/.ready
	$(BIN)/python -m benchmarks.net

figures: .venv/.ready
	$(BIN)/python -m benchmarks.figures

# After a change of behaviour that is meant: what the virtual flight looks like from now on.
golden: .venv/.ready
	$(BIN)/python -m tests.services.golden

# The same for the two real flights that are kept as recordings; PX4_BIN is PX4's program.
golden-recordings: .venv/.ready
	$(BIN)/python -m tests.golden_recordings

.venv/.ready: requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# Only when a dependency changes; needs uv.
lock:
	uv pip compile pyproject.toml --group dev --universal --python-version 3.11 --generate-hashes \
	  --no-emit-index-url --no-annotate --no-header --quiet --output-file requirements.lock

clean:
	rm -rf .venv sessions .pytest_cache .ruff_cache .hypothesis
