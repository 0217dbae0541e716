# make venv      .venv with everything in it, and the executables in .venv/bin
# make demo      align over the shipped bag, and over a simulated drive; results beside the truth
# make test      lint, types, import contract, tests
# make colcon    build the ROS package and look at what got installed
# make bench     speed
# make evidence  the figures behind the claims
# make clean     remove what the above wrote (make distclean: .venv too)
#
# make venv PYTHON=/path/to/python3 chooses the interpreter; else it is the first of these that
# runs, is Python 3.10 to 3.13 and can make a virtual environment.

PYENV_ROOT ?= $(HOME)/.pyenv
PYTHONS := $(if $(PYTHON),"$(PYTHON)",python3.12 "$(PYENV_ROOT)"/versions/3.12.*/bin/python \
	python3 python3.13 python3.11 python3.10)

BIN := .venv/bin
STAMP := .venv/.complete
EXTRAS := bag,colcon,ros,test

# Small matrices: threads cost more than they bring.
export OPENBLAS_NUM_THREADS := 1
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# .venv brings its own ROS: where another one is sourced, the two must not mix.
ifdef ROS_DISTRO
unexport PYTHONPATH AMENT_PREFIX_PATH LD_LIBRARY_PATH
endif

.DELETE_ON_ERROR:
.PHONY: venv demo test colcon bench evidence clean distclean

venv: $(STAMP)

$(STAMP): constraints.txt setup.py setup.cfg
	@if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then \
		lacking=; found=; \
		for python in $(PYTHONS); do \
			version=$$("$$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) \
				|| continue; \
			case $$version in 3.10|3.11|3.12|3.13) ;; *) continue ;; esac; \
			if "$$python" -c 'import ensurepip, venv; ensurepip.version()' 2>/dev/null; then found=$$python; break; fi; \
			lacking="$${lacking:-$$version}"; \
		done; \
		if [ -n "$$found" ]; then \
			echo "Python $$version ($$found) -> .venv"; "$$found" -m venv --clear .venv; \
		elif [ -n "$$lacking" ]; then \
			echo "make venv: Python $$lacking is here but cannot make a virtual environment." >&2; \
			echo "Install the missing part (Debian, Ubuntu: sudo apt install python$$lacking-venv)" >&2; \
			echo "or name another interpreter: make venv PYTHON=/path/to/python3" >&2; exit 1; \
		else \
			echo "make venv: no Python 3.10 to 3.13 that runs among: $(subst ",,$(PYTHONS))" >&2; \
			echo "Install one (Debian, Ubuntu: sudo apt install python3 python3-venv)" >&2; \
			echo "or name it: make venv PYTHON=/path/to/python3" >&2; exit 1; \
		fi; \
	fi
	$(BIN)/python -m pip install --quiet -c constraints.txt setuptools wheel
	$(BIN)/python -m pip install --quiet -c constraints.txt --no-build-isolation -e '.[$(EXTRAS)]'
	@touch $@

demo: venv
	$(BIN)/align_replay swing bags/swing_rlg --truth bags/swing_rlg/truth.json --out out/demo
	rm -rf out/drive
	$(BIN)/align_simulate odo --scenario urban --seed 1 --rate 100 --duration 400 --out out/drive
	$(BIN)/align_replay odo out/drive --params config/odo_align.yaml --truth out/drive/truth.json \
		--out out/demo_odo

test: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest

colcon: venv
	PATH="$(CURDIR)/$(BIN):$$PATH" .ci/check_colcon

bench: venv
	$(BIN)/python benchmarks/bench.py

evidence: venv
	$(BIN)/python evidence/run.py

clean:
	rm -rf build install log out sins_align.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './.venv/*' -prune -exec rm -rf {} +

distclean: clean
	rm -rf .venv
