# Everything happens in a private environment (.venv); nothing else on the machine is touched.
# make PYTHON=python3.12 ...   takes that Python instead of the first one that is found
# make LOCK= ...               takes the newest of every dependency instead of the versions in requirements.lock
PYTHON ?=
LOCK ?= requirements.lock
VENV ?= .venv
BIN := $(VENV)/bin
SUPPORTED := >=3.11,<3.14

.PHONY: demo test test-fast lint bench docs wheel release lock clean
.DEFAULT_GOAL := demo

# $(call install,EXTRAS): the package with its extras, at the versions of the lock
ifneq ($(shell command -v uv 2>/dev/null),)
install = uv pip install --quiet --compile-bytecode --python $(BIN)/python $(LOCK:%=-c %) -e '.$(1)'
else
install = $(BIN)/python -m pip install --quiet --disable-pip-version-check $(LOCK:%=-c %) -e '.$(1)'
endif

# the tests as pytest rewrites them are kept for the next run, whatever the environment says of compiled files
pytest = PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -q -n 2 --dist loadfile

$(VENV)/.installed: pyproject.toml $(LOCK)
	@if command -v uv >/dev/null 2>&1; then \
		uv venv --quiet --allow-existing --python '$(or $(PYTHON),$(SUPPORTED))' $(VENV); \
	else \
		$(or $(PYTHON),python3) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' || \
			{ echo 'mr360uw needs Python 3.11 to 3.13: make PYTHON=/path/to/python3.12'; exit 1; }; \
		$(or $(PYTHON),python3) -m venv $(VENV) || { echo 'venv is missing: sudo apt install python3-venv'; exit 1; }; \
	fi
	@$(call install,)
	@$(BIN)/python -m compileall -q mr360uw  # as installers do for wheels: where Python may not write, every start would compile the sources
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	@$(call install,[dev])
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	@$(call install,[docs])
	@touch $@

demo: $(VENV)/.installed  ## put a whale into the 360 dive of samples/demo, say where the results are
	@mkdir -p demo
	$(BIN)/mr360uw composite samples/demo/scene.toml demo/composite.mp4 --overwrite
	$(BIN)/python samples/demo/pictures.py demo/composite.mp4 demo
	@echo
	@echo 'demo/composite.mp4  the 360 video: open it in VLC and drag'
	@echo 'demo/still.png      a frame as an ordinary camera sees it'
	@echo 'demo/wipe.png       left the composite, right the plate'
	@echo 'Next: move the whale with position_m in samples/demo/scene.toml and run make demo again; or put a mesh of your own'
	@echo 'into a clip of your own: $(BIN)/mr360uw new dive.mp4 whale.glb'

test: $(VENV)/.installed-dev  ## the whole suite, on two workers
	$(pytest)

test-fast: $(VENV)/.installed-dev  ## physics and a run of each renderer, in forty seconds
	$(pytest) tests/agreement tests/caustics/test_caustics.py tests/caustics/test_refraction.py \
		tests/ibl/test_closure.py tests/ibl/test_integrals.py tests/medium/test_closed_form.py tests/medium/test_water.py \
		tests/test_color.py tests/test_sphere.py tests/test_jit.py tests/test_architecture.py \
		tests/test_pipeline.py::test_a_video_goes_in_and_a_video_comes_out

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/.installed-dev  ## every benchmark; tables on standard output
	@for program in $(filter-out benchmarks/smallest.py,$(wildcard benchmarks/*.py)); do echo "== $$program"; $(BIN)/python $$program; done

docs: $(VENV)/.installed-docs  ## the pages as a site in build/site, with every warning an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

wheel: $(VENV)/.installed-docs  ## wheel with kernels for each Python that is found, and sources, in dist; the wheel is tried on each
	rm -rf dist mr360uw/compiled build/wheel
	for python in $$(.ci/pythons); do \
		try=build/wheel/$$($$python -c 'import sys; print(sys.implementation.cache_tag)') && \
		$$python -m venv $$try && $$try/bin/python -m pip install --quiet --disable-pip-version-check $(LOCK:%=-c %) . && \
		NUMBA_CACHE_DIR=mr360uw/compiled $$try/bin/python -c 'from mr360uw.cli.rendering import compile_first; compile_first()' || exit 1; \
	done
	$(BIN)/python -m build --sdist --wheel --outdir dist . >/dev/null
	rm -rf mr360uw/compiled
	cd build/wheel && for try in */; do \
		$$try/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall ../../dist/mr360uw-*.whl && \
		$$try/bin/mr360uw --version && \
		MR360UW_CACHE=$$try/samples $$try/bin/mr360uw sample $$try/dive --width 256 --frames 2 && \
		MR360UW_CACHE=$$try/kept $$try/bin/mr360uw composite $$try/dive/scene.toml $$try/dive/out.mp4 && \
		missing=$$(find $$try/kept/kernels -name '*.nbc' -size +1k | wc -l) && \
		echo "$$try: the wheel lacks $$missing kernels of a composite" && test $$missing -lt 10 || exit 1; \
	done

release:  ## make release VERSION=1.2.3: names the version where it stands, cuts the changelog, and packs dist with its checksums
	@echo '$(VERSION)' | grep -qE '^[0-9]+\.[0-9]+\.[0-9]+$$' || { echo 'make release needs VERSION=1.2.3'; exit 1; }
	@grep -q '^## \[$(VERSION)\]' CHANGELOG.md && { echo '$(VERSION) is in CHANGELOG.md already'; exit 1; } || true
	old=$$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml) && sed -i "s/$$(echo $$old | sed 's/\./\\./g')/$(VERSION)/" \
		pyproject.toml mr360uw/__init__.py CITATION.cff docs/citing.md docs/install.md
	sed -i "s/^date-released: .*/date-released: $$(date +%F)/" CITATION.cff
	sed -i "s/^## \[Unreleased\]$$/## [Unreleased]\n\n## [$(VERSION)] - $$(date +%F)/" CHANGELOG.md
	$(MAKE) wheel
	cd dist && sha256sum mr360uw-* > SHA256SUMS && cat SHA256SUMS

lock:  ## the newest versions that go together on each Python, into requirements.lock (needs uv)
	uv pip compile --quiet --universal --python-version 3.11 --all-extras --no-annotate --upgrade \
		--custom-compile-command 'make lock' -o requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) demo build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
