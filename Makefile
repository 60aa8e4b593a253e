# make demo and make test do their own set-up.  PYTHON=... picks the interpreter, VENV=... the folder.
VENV ?= .venv
PYTHON ?=
RUN = $(VENV)/bin/python
# tests/NAME, or tests/studies/test_NAME.py
SUITES = blender gpu core studies-stability studies-measured studies-intervals \
	studies-resilience studies-fuzz studies-bench studies-budget studies-rungs studies-environment studies-emitters \
	studies-standard_errors studies-pages

.PHONY: setup demo test suites $(SUITES:%=test-%) test-gui same-maps screenshots lint lint-systems docs site bench stability zip release clean

# .ready is what the environment was made from, not a date: clones with the same pins can share one.
setup:
	@cat requirements-dev.txt requirements-docs.txt tools/setup.sh | cmp -s - "$(VENV)/.ready" || \
	bash tools/setup.sh "$(VENV)" "$(PYTHON)"

demo: setup
	$(RUN) -m irpso_addon demo --out build/demo

# Each suite is a process of its own: the GPU's tests prove that no Blender is needed and must not share one with it, and
# those of the studies make OpenGL contexts of their own.  A suite keeps one core busy, so JOBS of them run side by side, the
# longest first; each line says whose it is.  If one fails the others still run, and the target fails.
JOBS ?= $(shell getconf _NPROCESSORS_ONLN 2>/dev/null || echo 1)

suites:  # their names, for .ci/run
	@echo $(SUITES)

test: lint
	@$(MAKE) --no-print-directory --keep-going --jobs=$(JOBS) $(SUITES:%=test-%)

# Side by side, the software rasteriser needs no threads of its own (with some, glibc before 2.41 loses a wake-up once in
# a long while, and waits for ever), nor does NumPy's linear algebra, whose threads spin while they wait.
$(SUITES:%=test-%): test-%: setup
	@LP_NUM_THREADS=$${LP_NUM_THREADS-0} OPENBLAS_NUM_THREADS=$${OPENBLAS_NUM_THREADS-1} PYTHONUNBUFFERED=1 \
	bash -o pipefail -c \
	'"$$1" -m pytest "$$3" 2>&1 | while IFS= read -r line; do printf "%s | %s\n" "$$2" "$$line"; done' - \
	$(RUN) $* tests/$(patsubst studies-%,studies/test_%.py,$*)

# BLENDER=/path/to/blender picks one with a window; else Debian's is set up (as root).
test-gui: setup
	BLENDER=$${BLENDER:-$$(bash tools/gui_setup.sh)} && export BLENDER && $(RUN) -m pytest tests/gui

# For .ci/run, which compares what its Pythons save.
same-maps: setup
	@LP_NUM_THREADS=$${LP_NUM_THREADS-0} OPENBLAS_NUM_THREADS=$${OPENBLAS_NUM_THREADS-1} \
	$(RUN) -m tests.support.same_maps save build/maps-$(notdir $(VENV)).npz

screenshots: setup
	BLENDER=$${BLENDER:-$$(bash tools/gui_setup.sh)} && export BLENDER && $(RUN) -m tests.gui.screenshots

lint: setup
	$(RUN) -m ruff check .
	$(RUN) tools/style_check.py
	$(VENV)/bin/lint-imports --no-cache --no-logo
	@if $(RUN) -c 'import sys; sys.exit(sys.version_info < (3, 13))'; then echo $(RUN) -m mypy; $(RUN) -m mypy; \
	else echo "lint: mypy runs on Python 3.13 alone (this one's numpy 1.26 types too little)"; fi

# What Windows and macOS have not, as far as types tell.  In one cache each system's types would take the place of the
# others': every run would begin anew.
lint-systems: setup
	$(RUN) -m mypy --platform win32 --cache-dir .mypy_cache/win32
	$(RUN) -m mypy --platform darwin --cache-dir .mypy_cache/darwin

docs: setup
	$(RUN) tools/make_docs.py

site: setup
	$(RUN) -m mkdocs build

bench: $(VENV)-bench/.ready
	$(VENV)-bench/bin/python -m studies.bench

$(VENV)-bench/.ready: requirements-bench.txt
	"$$(bash tools/setup.sh --find 3.13)" -m venv --clear $(VENV)-bench
	$(VENV)-bench/bin/python -m pip install --quiet --disable-pip-version-check -r requirements-bench.txt
	@touch $@

stability: setup
	$(RUN) -m studies.stability

zip: setup
	$(RUN) -m tools.build

# dist/: the zips, a bill of materials, SHA256SUMS; docs/release.md says what else a release takes.
release: setup
	$(RUN) -m tools.release

clean:
	rm -rf .venv* build dist wheels .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
