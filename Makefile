# `make help` lists the targets. Every target that runs Python makes the environment first, once.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

VENV ?= .venv
PYTHON := $(VENV)/bin/python
BUF := $(VENV)/bin/buf
CLANG_FORMAT := $(VENV)/bin/clang-format
CLANG_TIDY ?= clang-tidy
# in a copy without git all that are there: given none, clang-format would read what is typed
CPP_FILES = $(or $(shell git ls-files 'client/cpp/*.cpp' 'client/cpp/*.hpp' 'client/cpp/*.h' 'client/cpp/*.c' 2>/dev/null), \
	$(shell find client/cpp -name '*.[ch]' -o -name '*.[ch]pp'))
READY := $(VENV)/.ready
PARTS := proto ardy server client/python client/tools compliance
LOWEST ?= $(OUT)/venv-lowest
OUT ?= out
PAGE := client/tools/motiongen_tools/view/page
DATA ?= $(OUT)/data
RUN ?= $(OUT)/mini
# the encoder of prompts that a model is trained with; the server is to be given the same
TEXT_ENCODER ?= static
# labels that a trained model was seen not to show, whose prompts are outside of what it knows: bow, of the built-in one
UNLEARNED ?=
RECIPE ?= ardy/motiongen_ardy/train/configs/mini.yaml
MODEL ?= motiongen-mini
ARGS ?=
CPP ?= yes
# processes that share the tests; 0: all in one, as a debugger wants it
JOBS ?= 2
DATA_USE := name the motion capture: make data CLIPS=folder-of-bvh LABELS=table.csv

# ---- environment

.PHONY: help
help: ## list the targets
	@awk 'BEGIN {FS = ":.*## "} /^[a-z0-9-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

.PHONY: setup
setup: $(READY) ## make .venv with all parts and the development tools
	@echo "ready: $(VENV)"

$(READY): constraints.txt requirements-dev.txt $(PARTS:%=%/pyproject.toml)
	@bash .ci/make_venv.sh "$(VENV)"
	$(PYTHON) -m pip install --quiet --constraint constraints.txt setuptools
	$(PYTHON) -m pip install --progress-bar on --no-build-isolation --constraint constraints.txt \
		--requirement requirements-dev.txt --editable ./proto --editable './ardy[gltf,hub,text,train]' --editable './server[tracing]' \
		--editable ./client/python --editable './client/tools[bench,pictures,view]' --editable ./compliance
	# it asks for the protobuf of its time, but needs none to run protoc
	$(PYTHON) -m pip install --quiet --no-deps --constraint constraints.txt grpcio-tools
	@touch $@

# ---- use

.PHONY: demo
demo: $(READY) ## serve the built-in model, play a story and seven characters beside it; BVH files and contact sheets in out/demo
	$(PYTHON) -m motiongen_tools demo --out $(OUT)/demo $(ARGS)

.PHONY: serve
serve: $(READY) ## serve the built-in model; options in ARGS, listed by make serve ARGS=--help
	$(PYTHON) -m motiongen_server $(ARGS)

.PHONY: viewer
viewer: $(PAGE)/node_modules/.package-lock.json ## fetch three.js, which the viewer's page draws with (needs npm)

$(PAGE)/node_modules/.package-lock.json: $(PAGE)/package-lock.json
	@command -v npm >/dev/null || { echo "three.js comes by npm: install Node.js (Debian, Ubuntu: apt-get install npm)" >&2; exit 1; }
	npm ci --prefix $(PAGE) --ignore-scripts --no-audit --no-fund
	@touch $@

.PHONY: view
view: $(READY) viewer ## see and steer characters in a browser, with a server of its own; SERVER=host:port looks at another
	$(PYTHON) -m motiongen_tools view $(if $(SERVER),--server $(SERVER),--start-server) $(ARGS)

# ---- check

.PHONY: check
check: lint types proto-check test tidy ## style, types, protos, all tests that need no system but a C++ toolchain (which it installs, by apt; CPP=no: none), and clang-tidy

.PHONY: test
test: $(READY) cpp-packages ## run all tests that need no GPU, in JOBS=2 processes; CPP=no leaves out those of the C++ client
	OMP_NUM_THREADS=1 $(PYTHON) -m pytest -n $(JOBS) -m 'not gpu and not system' $(if $(filter no,$(CPP)),--ignore tests/cpp) $(ARGS)

.PHONY: test-system
test-system: $(READY) system-packages cpp-packages browser-packages test-lowest viewer ## run the tests that build, install or take long, those with the oldest versions too
	$(PYTHON) -m pytest -m system $(ARGS)

.PHONY: system-packages
system-packages: $(READY) ## see that the programs of make test-system are there; installs them where apt-get may
	@bash .ci/system_packages.sh
	$(PYTHON) -m pip install --quiet --constraint constraints.txt --requirement requirements-system.txt

.PHONY: test-lowest
test-lowest: ## run the client's tests with the oldest grpcio, protobuf and numpy that it allows, in an environment of its own
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
contract: $(READY) ## test that our server keeps the protocol; any other: .venv/bin/motiongen-compliance HOST:PORT
	$(PYTHON) -m pytest compliance tests/contract $(ARGS)

.PHONY: e2e
e2e: $(READY) ## test a real server process with the real client
	$(PYTHON) -m pytest tests/e2e $(ARGS)

.PHONY: attack
attack: $(READY) ## attack a real server in every known way, and print what its neighbours noticed; a short form is in make test
	$(PYTHON) -m tests.attack --out $(OUT)/attack $(ARGS)

.PHONY: scale-demo
scale-demo: $(READY) ## kill one of two servers behind a proxy while 40 characters play (redis-server and haproxy by apt)
	$(PYTHON) -m tests.scale $(ARGS)

.PHONY: chaos
chaos: $(READY) ## ten minutes of troubles drawn from a seed, while characters play (redis-server and haproxy by apt)
	$(PYTHON) -m tests.scale.chaos $(ARGS)

.PHONY: lint
lint: $(READY) ## check style and format, of Python and C++
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(CLANG_FORMAT) --dry-run --Werror $(CPP_FILES)

.PHONY: fmt
fmt: $(READY) ## format, and mend what can be mended
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
proto-check: $(READY) ## check the protos: rules, format, what the last release promised, and that proto/python is current
	$(BUF) lint proto
	$(BUF) format --diff --exit-code proto
	$(BUF) breaking proto --against proto/released.binpb
	$(PYTHON) -m pytest -q tests/house/test_generated.py

.PHONY: proto-release
proto-release: $(READY) ## at a release only: keep the protos as what later ones must not break
	$(BUF) build proto --exclude-source-info --output proto/released.binpb

.PHONY: browser-packages
browser-packages: ## see that the browser that tests the viewer is there; installs it where apt-get may
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
cpp-system: $(READY) cpp-packages system-packages ## the part of test-system that is the C++ client's: packages, C#, Windows, sanitizers, 10,000 connects
	$(PYTHON) -m pytest -m system tests/system/test_cpp_packages.py $(ARGS)

.PHONY: tidy
tidy: $(READY) cpp-packages ## look for mistakes in the C++ client with clang-tidy, in files that have changed since they were looked at
	$(if $(filter no,$(CPP)),@echo "without the C++ client",@cmake -S client/cpp -B $(OUT)/cpp/tidy -G Ninja --log-level=WARNING \
		-DCMAKE_EXPORT_COMPILE_COMMANDS=ON -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON -DMOTIONGEN_EXAMPLES=ON \
		&& cmake --build $(OUT)/cpp/tidy --target motiongen_generated load_generated >/dev/null \
		&& $(PYTHON) .ci/clang_tidy.py $(OUT)/cpp/tidy $(CLANG_TIDY))

.PHONY: cpp-packages
cpp-packages: ## see that what the C++ client is built with is there; installs it where apt-get may
	$(if $(filter no,$(CPP)),@echo "without the C++ client",@bash .ci/cpp_packages.sh)

# ---- measure and make

.PHONY: bench
bench: $(READY) ## measure latency, throughput and memory of the built-in model; writes out/bench
	$(PYTHON) -m tests.bench --out $(OUT)/bench $(ARGS)

.PHONY: bench-scenarios
bench-scenarios: $(READY) ## play every scenario of `motiongen bench` in both precisions; writes a table to out/scenarios
	$(PYTHON) -m tests.bench.scenario_table --out $(OUT)/scenarios $(ARGS)

.PHONY: bench-service
bench-service: $(READY) ## measure what the service costs without a model; writes out/bench
	$(PYTHON) -m tests.bench.service_cost --out $(OUT)/bench $(ARGS)

.PHONY: bench-engine
bench-engine: $(READY) ## measure the engine against simpler ones: characters in real time, latencies, the ceiling; writes out/bench
	OMP_WAIT_POLICY=PASSIVE $(PYTHON) -m tests.bench.engine --out $(OUT)/bench $(ARGS)

.PHONY: fuzz
fuzz: $(READY) ## give the readers of files 10,000 broken ones each, and the edge what libFuzzer thinks up for 3 minutes
	$(PYTHON) -m tests.bench.fuzz_checkpoints
	$(PYTHON) -m tests.bench.fuzz_formats
	$(PYTHON) -m pip install --quiet --constraint constraints.txt atheris
	$(PYTHON) -m tests.bench.fuzz_edge $(ARGS)

.PHONY: data
data: $(READY) ## turn motion capture into a training set: make data CLIPS=folder-of-bvh LABELS=table.csv [DATA=out/data]
	$(PYTHON) -m motiongen_ardy.data build "$(or $(CLIPS),$(error $(DATA_USE)))" "$(or $(LABELS),$(error $(DATA_USE)))" "$(DATA)" $(ARGS)

.PHONY: train-mini
train-mini: $(READY) ## train what RECIPE says on DATA (the built-in model): tokenizer, then denoiser; goes on where it was stopped
	$(PYTHON) -m motiongen_ardy.train.tokenizer "$(DATA)" "$(RUN)/tokenizer" --config "$(RECIPE)" $(ARGS)
	$(PYTHON) -m motiongen_ardy.train.denoiser "$(DATA)" "$(RUN)/denoiser" --tokenizer "$(RUN)/tokenizer" --config "$(RECIPE)" \
		--text-encoder "$(TEXT_ENCODER)" $(ARGS)
	@if [ ! -e "$(RUN)/denoiser/capabilities.yaml" ]; then \
		echo "no prompt_paces and no prompt_domain: the files of $(RECIPE) have no capabilities.yaml, which says what they are of"; \
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
clean: ## remove what make made, the environment too
	rm -rf $(VENV) $(OUT) build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis $(PAGE)/node_modules
	# what pip leaves of a part that it builds, and puts into the next wheel of it, also what is no more among the sources
	rm -rf $(PARTS:%=%/build)
	find . -name __pycache__ -prune -exec rm -rf {} +
	find . -name '*.egg-info' -prune -exec rm -rf {} +
