# `make help` lists the targets. Every target that runs Python creates the environment first, if there is none.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

VENV ?= .venv
PYTHON := $(VENV)/bin/python
BUF := $(VENV)/bin/buf
CLANG_FORMAT := $(VENV)/bin/clang-format
CLANG_TIDY ?= clang-tidy
# without git, all files found: without a file argument, clang-format would wait for standard input
CPP_FILES = $(or $(shell git ls-files 'client/cpp/*.cpp' 'client/cpp/*.hpp' 'client/cpp/*.h' 'client/cpp/*.c' 2>/dev/null), \
	$(shell find client/cpp -name '*.[ch]' -o -name '*.[ch]pp'))
READY := $(VENV)/.ready
PARTS := proto ardy server client/python client/tools compliance
LOWEST ?= $(OUT)/venv-lowest
OUT ?= out
PAGE := client/tools/motiongen_tools/view/page
DATA ?= $(OUT)/data
RUN ?= $(OUT)/mini
# the text encoder of the prompts that a model is trained with; the server must use the same one
TEXT_ENCODER ?= static
# labels of motion that the trained model does not show, so that their prompts count as unknown to it: bow, for the
# built-in model
UNLEARNED ?=
RECIPE ?= ardy/motiongen_ardy/train/configs/mini.yaml
MODEL ?= motiongen-mini
ARGS ?=
CPP ?= yes
# number of processes that share the tests; 0: all run in the process of pytest, as a debugger needs
JOBS ?= 2
DATA_USE := name the motion capture: make data CLIPS=folder-of-bvh LABELS=table.csv

# ---- environment

.PHONY: help
help: ## list the targets
	@awk 'BEGIN {FS = ":.*## "} /^[a-z0-9-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

.PHONY: setup
setup: $(READY) ## create .venv with all parts and the development tools
	@echo "ready: $(VENV)"

$(READY): constraints.txt requirements-dev.txt $(PARTS:%=%/pyproject.toml)
	@bash .ci/make_venv.sh "$(VENV)"
	$(PYTHON) -m pip install --quiet --constraint constraints.txt setuptools
	$(PYTHON) -m pip install --progress-bar on --no-build-isolation --constraint constraints.txt \
		--requirement requirements-dev.txt --editable ./proto --editable './ardy[gltf,hub,text,train]' --editable './server[tracing]' \
		--editable ./client/python --editable './client/tools[bench,pictures,view]' --editable ./compliance
	# it requires an older protobuf, but needs none to run protoc
	$(PYTHON) -m pip install --quiet --no-deps --constraint constraints.txt grpcio-tools
	@touch $@

# ---- use

.PHONY: demo
demo: $(READY) ## serve the built-in model, play a story with seven more characters; writes BVH files and contact sheets to out/demo
	$(PYTHON) -m motiongen_tools demo --out $(OUT)/demo $(ARGS)

.PHONY: serve
serve: $(READY) ## serve the built-in model; options in ARGS, listed by make serve ARGS=--help
	$(PYTHON) -m motiongen_server $(ARGS)

.PHONY: viewer
viewer: $(PAGE)/node_modules/.package-lock.json ## fetch three.js for the viewer's page (needs npm)

$(PAGE)/node_modules/.package-lock.json: $(PAGE)/package-lock.json
	@command -v npm >/dev/null || { echo "npm is needed to fetch three.js: install Node.js (Debian, Ubuntu: apt-get install npm)" >&2; exit 1; }
	npm ci --prefix $(PAGE) --ignore-scripts --no-audit --no-fund
	@touch $@

.PHONY: view
view: $(READY) viewer ## see and steer characters in a browser; starts a server, or uses that of SERVER=host:port
	$(PYTHON) -m motiongen_tools view $(if $(SERVER),--server $(SERVER),--start-server) $(ARGS)

# ---- check

.PHONY: check
check: lint types proto-check test tidy ## style, types, protos, tests and clang-tidy; installs a C++ toolchain with apt-get if there is none (CPP=no: leave C++ out)

.PHONY: test
test: $(READY) cpp-packages ## run all tests but those of test-gpu and test-system, in JOBS=2 processes; CPP=no leaves out the C++ client's
	OMP_NUM_THREADS=1 $(PYTHON) -m pytest -n $(JOBS) -m 'not gpu and not system' $(if $(filter no,$(CPP)),--ignore tests/cpp) $(ARGS)

.PHONY: test-system
test-system: $(READY) system-packages cpp-packages browser-packages test-lowest viewer ## run the tests that build or install something or take long, and test-lowest
	$(PYTHON) -m pytest -m system $(ARGS)

.PHONY: system-packages
system-packages: $(READY) ## install the programs that test-system needs, where apt-get is allowed to
	@bash .ci/system_packages.sh
	$(PYTHON) -m pip install --quiet --constraint constraints.txt --requirement requirements-system.txt

.PHONY: test-lowest
test-lowest: ## run the client's tests with the oldest supported grpcio, protobuf and numpy, in a separate environment
	@bash .ci/make_venv.sh "$(LOWEST)"
	$(LOWEST)/bin/python -m pip install --quiet --constraint constraints-lowest.txt ./proto ./client/python
	$(LOWEST)/bin/python -m pip install --quiet --constraint constraints.txt hypothesis pytest pytest-asyncio pytest-timeout
	$(LOWEST)/bin/python -m pytest -p no:cacheprovider tests/client $(ARGS)

.PHONY: test-gpu
test-gpu: $(READY) ## run the tests that need a CUDA device
	$(PYTHON) -m pytest -m gpu $(ARGS)

.PHONY: parity
parity: $(READY) ## test that batched, streamed and saved motion equals the plain rollout
	$(PYTHON) -m pytest tests/parity $(ARGS)

.PHONY: contract
contract: $(READY) ## test that our server keeps the protocol; for any other server: .venv/bin/motiongen-compliance HOST:PORT
	$(PYTHON) -m pytest compliance tests/contract $(ARGS)

.PHONY: e2e
e2e: $(READY) ## test a real server process with the real client
	$(PYTHON) -m pytest tests/e2e $(ARGS)

.PHONY: attack
attack: $(READY) ## attack a real server in every known way, and print what other clients noticed; make test runs a short form
	$(PYTHON) -m tests.attack --out $(OUT)/attack $(ARGS)

.PHONY: scale-demo
scale-demo: $(READY) ## kill one of two servers behind a proxy while 40 characters play (redis-server and haproxy by apt)
	$(PYTHON) -m tests.scale $(ARGS)

.PHONY: chaos
chaos: $(READY) ## ten minutes of random faults, drawn from a seed, while characters play (redis-server and haproxy by apt)
	$(PYTHON) -m tests.scale.chaos $(ARGS)

.PHONY: lint
lint: $(READY) ## check style and format, of Python and C++
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(CLANG_FORMAT) --dry-run --Werror $(CPP_FILES)

.PHONY: fmt
fmt: $(READY) ## format, and fix what ruff can fix
	$(PYTHON) -m ruff check --fix .
	$(PYTHON) -m ruff format .
	$(CLANG_FORMAT) -i $(CPP_FILES)

.PHONY: types
types: $(READY) ## check types: mypy, strict on server, contract and clients
	$(PYTHON) -m mypy

.PHONY: proto
proto: $(READY) ## generate proto/python from the protos
	$(PYTHON) proto/generate.py

.PHONY: proto-check
proto-check: $(READY) ## check the protos: rules, format, compatibility with the last release, and that proto/python is current
	$(BUF) lint proto
	$(BUF) format --diff --exit-code proto
	$(BUF) breaking proto --against proto/released.binpb
	$(PYTHON) -m pytest -q tests/house/test_generated.py

.PHONY: proto-release
proto-release: $(READY) ## at a release only: save the protos as the baseline that later ones must be compatible with
	$(BUF) build proto --exclude-source-info --output proto/released.binpb

.PHONY: browser-packages
browser-packages: ## install the browser that the viewer's tests need, where apt-get is allowed to
	@bash .ci/browser_packages.sh

# ---- the C++ client

.PHONY: cpp
cpp: cpp-packages ## build the C++ client in out/cpp/release
	cmake -S client/cpp -B $(OUT)/cpp/release -G Ninja $(ARGS)
	cmake --build $(OUT)/cpp/release

.PHONY: cpp-test
cpp-test: $(READY) cpp-packages ## build and test the C++ client
	$(PYTHON) -m pytest -m 'not gpu and not system' tests/cpp $(ARGS)

.PHONY: cpp-system
cpp-system: $(READY) cpp-packages system-packages ## run the C++ client's part of test-system: packages, C#, Windows, sanitizers, 10,000 connects
	$(PYTHON) -m pytest -m system tests/system/test_cpp_packages.py $(ARGS)

.PHONY: tidy
tidy: $(READY) cpp-packages ## check the C++ client with clang-tidy, only files that have changed since they last passed
	$(if $(filter no,$(CPP)),@echo "without the C++ client",@cmake -S client/cpp -B $(OUT)/cpp/tidy -G Ninja --log-level=WARNING \
		-DCMAKE_EXPORT_COMPILE_COMMANDS=ON -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON -DMOTIONGEN_EXAMPLES=ON \
		&& cmake --build $(OUT)/cpp/tidy --target motiongen_generated load_generated >/dev/null \
		&& $(PYTHON) .ci/clang_tidy.py $(OUT)/cpp/tidy $(CLANG_TIDY))

.PHONY: cpp-packages
cpp-packages: ## install what the C++ client is built with, where apt-get is allowed to
	$(if $(filter no,$(CPP)),@echo "without the C++ client",@bash .ci/cpp_packages.sh)

# ---- measure and make

.PHONY: bench
bench: $(READY) ## measure latency, throughput and memory of the built-in model; writes out/bench
	$(PYTHON) -m tests.bench --out $(OUT)/bench $(ARGS)

.PHONY: bench-scenarios
bench-scenarios: $(READY) ## run every scenario of `motiongen bench` in both precisions; writes a table to out/scenarios
	$(PYTHON) -m tests.bench.scenario_table --out $(OUT)/scenarios $(ARGS)

.PHONY: bench-service
bench-service: $(READY) ## measure what the service costs without a model; writes out/bench
	$(PYTHON) -m tests.bench.service_cost --out $(OUT)/bench $(ARGS)

.PHONY: bench-engine
bench-engine: $(READY) ## compare the engine with simpler ones: characters in real time, latencies, upper bound; writes out/bench
	OMP_WAIT_POLICY=PASSIVE $(PYTHON) -m tests.bench.engine --out $(OUT)/bench $(ARGS)

.PHONY: fuzz
fuzz: $(READY) ## fuzz each reader of files with 10,000 broken ones, and the edge with libFuzzer for 3 minutes
	$(PYTHON) -m tests.bench.fuzz_checkpoints
	$(PYTHON) -m tests.bench.fuzz_formats
	$(PYTHON) -m pip install --quiet --constraint constraints.txt atheris
	$(PYTHON) -m tests.bench.fuzz_edge $(ARGS)

.PHONY: data
data: $(READY) ## turn motion capture into a training set: make data CLIPS=folder-of-bvh LABELS=table.csv [DATA=out/data]
	$(PYTHON) -m motiongen_ardy.data build "$(or $(CLIPS),$(error $(DATA_USE)))" "$(or $(LABELS),$(error $(DATA_USE)))" "$(DATA)" $(ARGS)

.PHONY: train-mini
train-mini: $(READY) ## train the model of RECIPE (the built-in one) on DATA: tokenizer, then denoiser; continues where it was stopped
	$(PYTHON) -m motiongen_ardy.train.tokenizer "$(DATA)" "$(RUN)/tokenizer" --config "$(RECIPE)" $(ARGS)
	$(PYTHON) -m motiongen_ardy.train.denoiser "$(DATA)" "$(RUN)/denoiser" --tokenizer "$(RUN)/tokenizer" --config "$(RECIPE)" \
		--text-encoder "$(TEXT_ENCODER)" $(ARGS)
	@if [ ! -e "$(RUN)/denoiser/capabilities.yaml" ]; then \
		echo "prompt_paces and prompt_domain are skipped: they need a capabilities.yaml, and $(RECIPE) lists none under files"; \
	else \
		set -x; \
		$(PYTHON) -m motiongen_ardy.train.prompt_paces "$(DATA)" "$(RUN)/denoiser" --text-encoder "$(TEXT_ENCODER)"; \
		$(PYTHON) -m motiongen_ardy.train.prompt_domain "$(DATA)" "$(RUN)/denoiser" --text-encoder "$(TEXT_ENCODER)" \
			$(if $(UNLEARNED),--without $(UNLEARNED)); \
	fi

.PHONY: gate
gate: $(READY) ## judge the motion of MODEL on the test split of DATA; exit code 1 if it misses a bound
	$(PYTHON) -m motiongen_ardy.evaluate "$(MODEL)" "$(DATA)" $(ARGS)

.PHONY: clean
clean: ## remove everything that make created, including the environment
	rm -rf $(VENV) $(OUT) build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis $(PAGE)/node_modules
	# pip leaves these when it builds a part, and puts them into the part's next wheel, even files deleted from the sources
	rm -rf $(PARTS:%=%/build)
	find . -name __pycache__ -prune -exec rm -rf {} +
	find . -name '*.egg-info' -prune -exec rm -rf {} +
