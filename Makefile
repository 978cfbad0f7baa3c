# Two commands set everything up on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
MESH_VENV ?= $(VENV)-mesh
PARSERS_VENV ?= $(VENV)-parsers
SITE_VENV ?= $(VENV)-site
CLUSTER_VENV ?= $(VENV)-cluster
DEMO ?= demo
DATA ?= ../shared/data/kitti_raw_397x120
REAL ?= ../shared/data
SAMPLES ?= samples
DEVICE ?= cuda
INSTALL := -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
PIP := $(BIN)/python $(INSTALL)

.DEFAULT_GOAL := help
.PHONY: help fix cov demo test modes slow browser site splats datasets stress networks parsers mesh cluster properties lint types bench gpu gpu-pack gpu-crops clean

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable .
	touch $@

$(VENV)/.dev: $(VENV)/.installed
	$(PIP) --editable .[dev]
	touch $@

help:  ## this list
	@sed -n 's/^\([a-z][a-z -]*\):.*##  *\(.*\)/\1|\2/p' $(MAKEFILE_LIST) | while IFS='|' read -r names what; do \
		printf '  %-26s %s\n' "$$names" "$$what"; done

demo: $(VENV)/.installed  ## the whole story on the embedded street: four priors, their table, a field without and with one, a page
	$(BIN)/priors street $(DEMO)/street --frames 30 --size 416x128
	for method in lidar completion stereo mono; do \
		$(BIN)/priors build $(DEMO)/street --method $$method --cache $(DEMO)/cache || exit 1; done
	$(BIN)/priors eval $(DEMO)/cache --save $(DEMO)/table.md
	$(BIN)/nerf fit $(DEMO)/street --views sparse --steps 800 --run $(DEMO)/runs/colours-alone
	$(BIN)/nerf fit $(DEMO)/street --views sparse --steps 800 --run $(DEMO)/runs/with-stereo \
		--prior $$(ls -d $(DEMO)/cache/*/stereo-*)
	[ -f $(DEMO)/runs/with-stereo/video.mp4 ] || \
		$(BIN)/nerf video $(DEMO)/runs/with-stereo --steps 1 --fps 10
	$(BIN)/nerf report $(DEMO)/runs --cache $(DEMO)/cache --out $(DEMO)/report.html
	@echo "open $(DEMO)/report.html in a browser"

test: $(VENV)/.dev  ## the quick tests
	$(BIN)/python -m pytest -m "not slow and not browser and not docs and not splats and not datasets and not stress and not networks and not cluster"

properties: export HYPOTHESIS_PROFILE := random
properties: $(VENV)/.dev  ## the tests of properties, with examples that no run had before
	$(BIN)/python -m pytest -q -m "hypothesis and not slow"

$(PARSERS_VENV)/.installed: tests/parsers/requirements.txt
	$(PYTHON) -m venv $(PARSERS_VENV)
	$(PARSERS_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --requirement $<
	touch $@

parsers: $(PARSERS_VENV)/.installed  ## other programs' own parsers, in an environment of their own, without dependencies

datasets: export ROADPRIOR_PARSERS := $(abspath $(PARSERS_VENV))/bin/python
datasets: $(PARSERS_VENV)/.installed

splats datasets stress networks: $(VENV)/.dev  ## tests of one part each
	$(BIN)/python -m pytest -q -m "$@ and not slow"

# What is compiled or chosen by the CPU's mode: fields, their fit, networks.
MODE_TESTS := $(addprefix tests/test_,nerf_mlp.py nerf_field.py nerf_grid.py nerf_render.py nerf_sample.py \
	nerf_occupancy.py nerf_skips.py short_fit.py nets.py nets_runtime.py nets_int8.py mffnet.py stereo_model.py)

modes: $(VENV)/.dev  ## the same in every CPU mode that this CPU can stand in for; what was compiled is kept
	for mode in $$($(BIN)/python -c "from priors.machine import cpu; print(*cpu.supported()[1:])"); do \
		echo "ROADPRIOR_CPU=$$mode"; \
		ROADPRIOR_CPU=$$mode $(BIN)/python -m pytest -q -m "not slow" -k "not pcwnet-s" $(MODE_TESTS) || exit 1; done

slow: $(VENV)/.dev  ## the slow ones
	$(BIN)/python -m pytest -m slow

$(VENV)/.browser: $(VENV)/.dev
	$(PIP) --editable .[dev] playwright
	touch $@

browser: $(VENV)/.browser  ## pages in a real browser: Chromium, which is installed by apt-get where that can be done
	.ci/chromium
	ROADPRIOR_BROWSER=required $(BIN)/python -m pytest -q -m browser

$(MESH_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(MESH_VENV)
	$(MESH_VENV)/bin/python $(INSTALL) --editable .[mesh] pytest hypothesis
	touch $@

mesh: $(MESH_VENV)/.installed  ## meshes and clouds by open3d, in an environment of its own: it brings 0.6 GB
	.ci/open3d-libraries
	ROADPRIOR_OPEN3D=required $(MESH_VENV)/bin/python -m pytest -q -p no:dash tests/test_open3d.py

$(CLUSTER_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(CLUSTER_VENV)
	$(CLUSTER_VENV)/bin/python $(INSTALL) --editable .[cluster] pytest hypothesis "moto[s3]" flask flask-cors
	touch $@

cluster: $(CLUSTER_VENV)/.installed  ## Ray, object stores, data-parallel fits, in an environment of its own: it brings 0.6 GB
	ROADPRIOR_CLUSTER=required $(CLUSTER_VENV)/bin/python -m pytest -q -p no:dash -m "cluster and not slow"

fix: $(VENV)/.dev  ## what ruff can mend: order of imports, format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

cov: $(VENV)/.dev  ## the quick tests' coverage, without what numba compiles: the least covered files come last
	$(PIP) pytest-cov
	$(BIN)/python -m pytest -q -m "not slow and not browser" --cov --cov-report=
	$(BIN)/coverage report --skip-covered --sort=-cover

$(SITE_VENV)/.installed: constraints.txt
	$(PYTHON) -m venv $(SITE_VENV)
	$(SITE_VENV)/bin/python $(INSTALL) zensical mkdocstrings-python ruff
	touch $@

site: $(SITE_VENV)/.installed $(VENV)/.dev  ## the documentation as a site, build/site, and the code of its pages run
	$(SITE_VENV)/bin/python docs/_site.py
	$(SITE_VENV)/bin/zensical build --strict
	$(BIN)/python -m pytest -q -m docs

lint: $(VENV)/.dev  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev  ## mypy, strict
	$(BIN)/mypy

bench: $(VENV)/.dev  ## interleaved timings and errors against named peers; see docs/benchmarks.md
	for file in tests/bench/bench_*.py; do $(BIN)/python $$file || exit 1; done

gpu-pack: $(VENV)/.dev  ## what a borrowed GPU needs, in one small folder; nothing where the data is missing
	if [ -d "$(DATA)" ]; then $(BIN)/python tests/bench/gpu --make-pack --data "$(DATA)"; fi

gpu-crops: $(VENV)/.dev  ## what training on a borrowed GPU needs, 36 MiB; SAMPLES names the folder of `priors train samples`
	if [ -d "$(SAMPLES)" ]; then $(BIN)/priors train pack-crops gpu-crops --street "$(SAMPLES)" --real "$(REAL)" --mib 36; fi

gpu: gpu-pack gpu-crops  ## what a borrowed GPU is asked: docs/gpu.md; DEVICE=cpu BUDGET=150 rehearses it
	$(BIN)/python tests/bench/gpu --device $(DEVICE) $(if $(BUDGET),--budget $(BUDGET)) $(if $(PARTS),--parts $(PARTS))

clean:  ## remove the environments and the demo
	rm -rf $(VENV) $(MESH_VENV) $(PARSERS_VENV) $(SITE_VENV) $(CLUSTER_VENV) build $(DEMO)
