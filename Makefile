# make demo   record, learn, estimate, evaluate; make test   everything CI runs; make soak   long runs; make bench   speed; make validation   the tables of errors; make site   the pages
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
KERNELS := bodylog/estimation/inference/kernels.py

.PHONY: demo demo-bare test test-all lint soak bench validation wheel docs site clean

# The kernels are compiled here, before tests run side by side.
$(VENV)/installed: pyproject.toml $(KERNELS)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[all,test,docs]'
	$(BIN)/python -c 'from bodylog.estimation.inference.kernel_call import load_kernels; load_kernels()'
	touch $@

# Explore, learn the body from it, replay a second log against it, score it, draw it.
demo: $(VENV)/installed
	mkdir -p demo
	$(BIN)/bodylog record babble -o demo/explore.mcap --seed 1
	$(BIN)/bodylog record reach -o demo/reach.mcap --seed 2
	$(BIN)/bodylog fit demo/explore.mcap -o demo/body.npz
	$(BIN)/bodylog estimate demo/reach.mcap --body demo/body.npz -o demo/estimate.mcap
	$(BIN)/bodylog report demo/estimate.mcap -o demo/report.html --figures demo/figures
	@echo
	@echo "How good it is (rad; raw encoders beside it):"
	@$(BIN)/bodylog evaluate demo/estimate.mcap
	@echo
	@echo "The annotated log, for any MCAP viewer:  $(CURDIR)/demo/estimate.mcap"
	@echo "The report, for a browser:               $(CURDIR)/demo/report.html"
	@echo "Figures:                                 $(CURDIR)/demo/figures"

# The same without a marker: the URDF in the log, and the texture of the links, which a seed decides.
demo-bare: $(VENV)/installed
	mkdir -p demo
	$(BIN)/bodylog record babble --full --scene bare -o demo/bare_explore.mcap --seed 1 --duration 24
	$(BIN)/bodylog record reach --scene bare -o demo/bare_reach.mcap --seed 1 --duration 12
	$(BIN)/bodylog fit demo/bare_explore.mcap --urdf log -o demo/bare_body.npz
	$(BIN)/bodylog estimate demo/bare_reach.mcap --body demo/bare_body.npz -o demo/bare_estimate.mcap
	$(BIN)/bodylog calibration demo/bare_body.npz

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check bodylog cli
	$(BIN)/mypy --strict bodylog cli

# Side by side, a worker with one thread of linear algebra per core: more of them would spin while they wait.
# Compiled modules are kept, whatever the shell says: commands that tests run as processes start in two thirds of the time.
# For a single test, or in a debugger: .venv/bin/pytest -k NAME
test: $(VENV)/installed
	$(MAKE) --jobs=2 lint wheel site
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --numprocesses auto --dist worksteal

# The tests on every Python of pyproject.toml, and with the lowest version of every dependency; each must be installed.
# Those of numbers also as on other processors.
test-all: test
	$(BIN)/python tests/every_processor.py -- --numprocesses auto --dist worksteal
	$(BIN)/python tests/every_python.py lowest 3.12 3.13 -- --numprocesses auto --dist worksteal

soak: $(VENV)/installed
	$(BIN)/pytest -m soak

# Speed and memory beside peers; writes docs/performance.md, and exits with 4 where a bound is broken. Half an hour.
bench: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[all,test,bench]'
	$(BIN)/python -m tests.benchmarks

# Every table of figures in docs/validation.md and docs/learning.md that a script makes. Half an hour of one core.
validation: $(VENV)/installed
	$(BIN)/python -m tests.validation

# The wheel, built and used where nothing of the checkout can be seen.
wheel: $(VENV)/installed
	$(BIN)/python tests/wheel.py

# The pages that are generated from the code.
docs: $(VENV)/installed
	$(BIN)/python -m docs.generate_cli
	$(BIN)/python -m docs.generate_settings

# The pages as a site in build/site; a broken link or a page that the navigation does not list is an error.
site: $(VENV)/installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf $(VENV) build dist demo *.egg-info
