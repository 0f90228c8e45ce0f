# Everything happens in a private environment (.venv); nothing else on the machine is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-fast lint bench docs wheel clean
.DEFAULT_GOAL := demo

$(VENV)/.installed: pyproject.toml
	@if command -v uv >/dev/null 2>&1; then \
		uv venv --quiet --allow-existing --python '>=3.11,<3.14' $(VENV) && \
		uv pip install --quiet --python $(BIN)/python -e '.[dev]'; \
	else \
		$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' || \
			{ echo 'mr360uw needs Python 3.11 to 3.13: make PYTHON=/path/to/python3.12'; exit 1; }; \
		$(PYTHON) -m venv $(VENV) || { echo 'venv is missing: sudo apt install python3-venv'; exit 1; }; \
		$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'; \
	fi
	@touch $@

demo: $(VENV)/.installed  ## put a whale into the 360 dive of samples/demo, say where the results are
	@mkdir -p demo
	$(BIN)/mr360uw composite samples/demo/scene.toml demo/composite.mp4 --overwrite
	$(BIN)/python samples/demo/pictures.py look demo/composite.mp4 demo
	@echo
	@echo 'demo/composite.mp4  the 360 video: open it in VLC and drag'
	@echo 'demo/still.png      a frame as an ordinary camera sees it'
	@echo 'demo/wipe.png       left the plate, right the composite'
	@echo 'Next: move the whale with position_m in samples/demo/scene.toml and run make demo again; or put a mesh of your own'
	@echo 'into a clip of your own: $(BIN)/mr360uw new dive.mp4 whale.glb'

test: $(VENV)/.installed  ## the whole suite, on two workers
	$(BIN)/python -m pytest -q -n 2 --dist loadfile

test-fast: $(VENV)/.installed  ## physics and a run of each renderer, in forty seconds
	$(BIN)/python -m pytest -q -n 2 --dist loadfile tests/agreement tests/caustics/test_caustics.py tests/caustics/test_refraction.py \
		tests/ibl/test_closure.py tests/ibl/test_integrals.py tests/medium/test_closed_form.py tests/medium/test_water.py \
		tests/test_color.py tests/test_sphere.py tests/test_jit.py tests/test_architecture.py \
		tests/test_pipeline.py::test_a_video_goes_in_and_a_video_comes_out

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/.installed  ## every benchmark; tables on standard output
	@for program in benchmarks/*.py; do echo "== $$program"; $(BIN)/python $$program; done

docs: $(VENV)/.installed-docs  ## the pages as a site in build/site, with every warning an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

$(VENV)/.installed-docs: $(VENV)/.installed
	@if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(BIN)/python -e '.[docs]'; \
	else $(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'; fi
	@touch $@

wheel: $(VENV)/.installed-docs  ## wheel with compiled kernels and sources in dist, tried in an environment of their own
	rm -rf dist build/fresh mr360uw/compiled
	NUMBA_CACHE_DIR=mr360uw/compiled $(BIN)/python -c 'from mr360uw.cli.rendering import compile_first; compile_first()'
	$(BIN)/python -m build --sdist --wheel --outdir dist . >/dev/null
	rm -rf mr360uw/compiled
	$(PYTHON) -m venv build/fresh
	build/fresh/bin/python -m pip install --quiet --disable-pip-version-check dist/mr360uw-*.whl
	cd build/fresh && bin/mr360uw --version && bin/mr360uw sample dive --width 256 --frames 2 --overwrite \
		&& bin/mr360uw composite dive/scene.toml dive/out.mp4 --overwrite

clean:
	rm -rf $(VENV) demo build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
