# Everything happens in .venv; each target sets up what it needs.

PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3.13 || command -v python3)
BIN := .venv/bin

# Files of tests side by side: half of the suite waits for sockets and processes.
AT_ONCE := -n 3 --dist loadfile

VERSION = $(shell sed -n 's/^__version__ = "\(.*\)"$$/\1/p' fuzzbee/version.py)

.PHONY: demo test warm smoke test-python setup style types release wheels kernels build docs clean

## demo: the simulated vehicle through the live service, judged by its truth, in the terminal
demo: warm
	$(BIN)/fuzzbee run sim:flight --seconds 80

## test: the whole test suite
test: .venv/developer warm
	$(BIN)/python -m pytest -q $(AT_ONCE)

## warm: compile the filter, once for each state of the sources: a minute
warm: .venv/installed
	@$(BIN)/python -m fuzzbee.kernels

## test-python: what is quick without numba: there 0/0 is an error, and lines can be stepped through
test-python: .venv/developer
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -q $(AT_ONCE) $(QUICK_IN_PYTHON:%=tests/estimator/%)

# Not the flights and experiments: those take minutes each in plain Python.
QUICK_IN_PYTHON := conditioning geometry filter/test_filter.py filter/test_stability.py \
  filter/test_alignment.py test_estimator.py test_profile.py test_published.py \
  aiding/test_measurements.py aiding/test_place.py aiding/test_search.py \
  aiding/test_correction.py aiding/test_late_report.py

## smoke: every benchmark for some seconds, to see that it runs; `make test` does so, too
smoke: .venv/developer
	$(BIN)/python -m pytest -q -n 2 tests/test_benchmarks.py

## setup: the environment for development
setup: .venv/developer

style: .venv/developer
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: .venv/developer
	$(BIN)/mypy

## docs: the documentation as a site, in build/site
docs: .venv/developer
	$(BIN)/mkdocs build --strict -q

## kernels: the filter compiled for this Python, for the wheel
kernels: .venv/installed
	rm -rf estimator/kernels
	$(BIN)/python -m fuzzbee.kernels

build: .venv/developer kernels
	rm -rf dist
	$(BIN)/python -m build --wheel

## wheels: for each of PYTHONS that this machine has a wheel with its kernels, tried where nothing else
## is; on aarch64 the same makes wheels for that
PYTHONS ?= python3.11 python3.12 python3.13
wheels:
	rm -rf dist build/wheels
	@for each in $(PYTHONS); do \
	  $$each -c '' 2>/dev/null || { echo "no $$each here: no wheel for it"; continue; }; \
	  .ci/wheel "$$each" "build/wheels/$$(basename "$$each")" || exit 1; \
	done

## changelog: what is Unreleased in CHANGELOG.md becomes the section of the version in fuzzbee/version.py
changelog:
	@! grep -q '^## $(VERSION)\b' CHANGELOG.md || { echo "changelog: there is a section $(VERSION)" >&2; exit 1; }
	sed -i 's/^## Unreleased$$/## Unreleased\n\n## $(VERSION) ($(shell date +%F))/' CHANGELOG.md
	sed -i 's/^version: .*/version: $(VERSION)/' CITATION.cff

## release: build wheel and sdist, check them, list what they need (SBOM, CycloneDX), cut out the
## changelog's section, and tag the version that fuzzbee/version.py and CHANGELOG.md name
release: .venv/developer wheels
	@test -z "$$(git status --porcelain)" || { echo "release: commit or remove what git status shows" >&2; exit 1; }
	@grep -q '^## $(VERSION)\b' CHANGELOG.md || { echo "release: CHANGELOG.md has no heading '## $(VERSION)': make changelog" >&2; exit 1; }
	@grep -q '^version: $(VERSION)$$' CITATION.cff || { echo "release: CITATION.cff is of another version" >&2; exit 1; }
	@! git rev-parse -q --verify 'refs/tags/v$(VERSION)' >/dev/null || { echo "release: v$(VERSION) is tagged already" >&2; exit 1; }
	rm -rf build/installed build/tools build/release
	$(BIN)/python -m build --sdist
	$(BIN)/python -m venv build/tools
	build/tools/bin/python -m pip install -q 'twine>=6.1' 'cyclonedx-bom>=7'
	build/tools/bin/twine check --strict dist/*.whl dist/*.tar.gz
	$(BIN)/python -m venv build/installed
	build/installed/bin/python -m pip install -q -c constraints.txt --find-links dist fuzzbee==$(VERSION)
	mkdir -p build/release
	build/tools/bin/cyclonedx-py environment build/installed/bin/python --pyproject pyproject.toml \
	  --output-reproducible -o build/release/fuzzbee-$(VERSION).cdx.json
	sed -n '/^## $(VERSION)\b/,/^## /{/^## /!p}' CHANGELOG.md > build/release/notes-$(VERSION).md
	git tag -a 'v$(VERSION)' -m 'fuzzbee $(VERSION)'
	@echo "v$(VERSION) is tagged, dist/ is checked, build/release/ has the notes and the SBOM; git push origin v$(VERSION) and an upload are yours"

clean:
	rm -rf .venv dist build estimator/kernels

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "fuzzbee needs Python 3.11 or later (set PYTHON=...)" >&2; exit 1; }
	@echo "making .venv"
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install -q --upgrade 'pip>=25.1'

.venv/installed: .venv/bin/python pyproject.toml constraints.txt
	@echo "installing what fuzzbee needs: 150 MB to fetch, 600 MB in .venv, a minute or two"
	@$(BIN)/python -m pip install -q --progress-bar=on -c constraints.txt -e .
	@touch $@

.venv/developer: .venv/installed
	@echo "installing every extra and the developer's tools: 1.5 GB more in .venv, some minutes"
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[plot,page,mcap,bags,metrics,viewer,cluster,optimizers]' --group dev
	touch $@
