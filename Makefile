# make demo and make test do their own set-up.  PYTHON=... picks the interpreter, VENV=... the folder.
VENV ?= .venv
PYTHON ?=
RUN = $(VENV)/bin/python

.PHONY: setup demo test lint docs bench zip clean

setup: $(VENV)/.ready

$(VENV)/.ready: requirements-dev.txt tools/setup.sh
	@bash tools/setup.sh "$(VENV)" "$(PYTHON)"

demo: setup
	$(RUN) -m irpso_addon demo --out build/demo

# Two processes: the GPU's tests prove that no Blender is needed, and must not share a process with one.
test: lint
	$(RUN) -m pytest tests/core tests/gpu
	$(RUN) -m pytest tests/blender

lint: setup
	$(RUN) -m ruff check .
	@if $(RUN) -c 'import sys; sys.exit(sys.version_info < (3, 13))'; then echo $(RUN) -m mypy; $(RUN) -m mypy; \
	else echo "lint: mypy runs on Python 3.13 alone (this one's numpy 1.26 types too little)"; fi

docs: setup
	$(RUN) tools/make_docs.py

bench: setup
	$(RUN) tools/benchmark.py

zip: setup
	$(RUN) tools/build.py

clean:
	rm -rf .venv* build dist wheels .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
