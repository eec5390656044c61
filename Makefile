# `make serve` and `make test` are all that is needed; each sets up what it uses.

.PHONY: help serve test build onnxruntime page-tools page-types page-check page-pictures lint advisories bench bench-pnp bench-serve bench-networks soak openapi fmt train-env train-test render-env fresh-scenes evaluate-fresh fuzz bench-views bench-track hot-add films evaluate-films bench-compare

help: ## Lists the targets.
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

onnxruntime: ## Puts ONNX Runtime into .onnxruntime/.
	@scripts/fetch-onnxruntime.sh

build: ## Builds the program.
	cargo build --release --locked

serve: onnxruntime build ## Serves the bundled models on ports 8080 (HTTP) and 9000 (gRPC), with more FLAGS if given.
	@echo
	@echo "Once it says 'ready', in another terminal:"
	@echo "  curl --data-binary @samples/$(firstword $(notdir $(wildcard samples/*.jpg))) 'localhost:8080/v1/poses?camera=demo'"
	@echo
	@echo "or open http://localhost:8080 in a browser."
	@echo
	target/release/posed serve --cameras samples $(FLAGS)

# Built once: three minutes on two cores.
DENY := .tools/bin/cargo-deny
$(DENY):
	cargo install --quiet --locked --root .tools --no-default-features --version 0.20.2 cargo-deny

# The page's tests drive a real browser, and look at the page with axe-core.
page-tools:
	@scripts/install-chromium.sh
	@scripts/fetch-axe.sh

test: onnxruntime page-tools ## Runs the unit, property and end-to-end tests; the page's in a browser (Debian's Chromium).
	cargo test --release --locked --workspace

web/node_modules: web/package-lock.json
	cd web && npm ci --silent --no-audit --no-fund
	touch $@

page-types: web/node_modules ## Writes web/types.d.ts anew from docs/openapi.json (needs npm).
	cd web && npm run --silent types

page-check: web/node_modules ## Checks the types of the page, and that web/types.d.ts is that of docs/openapi.json (needs npm).
	cd web && npx --no openapi-typescript ../docs/openapi.json --output .types.d.ts >/dev/null && diff -q types.d.ts .types.d.ts && rm .types.d.ts
	cd web && npm run --silent check

PICTURES := /tmp/posed-pages
page-pictures: onnxruntime page-tools ## Takes pictures of every view into PICTURES, and prints the times of the first paint.
	POSED_PICTURES=$(PICTURES) cargo test --release --locked --test page -- --ignored --nocapture pictures

lint: $(DENY) ## Formatting, lints, licences and sources of dependencies, as CI runs them.
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps
	$(DENY) --locked check --hide-inclusion-graph bans licenses sources

advisories: $(DENY) ## Known vulnerabilities of dependencies (fetches the RustSec database).
	$(DENY) --locked check advisories

openapi: onnxruntime ## Writes docs/openapi.json anew.
	POSED_UPDATE=1 cargo test --release --locked --test server the_description_is_checked_in

fmt: ## Formats the code.
	cargo fmt --all

bench: onnxruntime ## Times the solver, the stages around the networks and the errors of an evaluation.
	cargo bench --locked --package posed-core --bench pnp --bench views
	cargo bench --locked --bench stages --bench evaluation

# The demo models before they computed in 8 bits.
BASELINE := b1f939f
target/baseline/models:
	mkdir -p target/baseline && git archive $(BASELINE) models | tar -x -C target/baseline

bench-serve: onnxruntime target/baseline/models ## Compares the server with bare loops, and overloads it; writes docs/benchmarks/serve.md.
	POSED_BASELINE=target/baseline/models POSED_BENCH_OUT=docs/benchmarks/serve.md cargo bench --locked --bench serve

bench-networks: onnxruntime target/baseline/models ## Times the networks on every provider that runs here; writes docs/benchmarks/providers.md.
	POSED_BASELINE=target/baseline/models POSED_BENCH_OUT=docs/benchmarks/providers.md cargo bench --locked --bench networks

bench-views: onnxruntime ## Compares three views as one request with their networks alone, and with three requests.
	cargo bench --locked --bench views

bench-track: onnxruntime ## Compares a stream that tracks with single images (POSED_FILM: a scene; default: the tests').
	cargo bench --locked --bench track

hot-add: onnxruntime ## Prints what it costs to add an object to a server that is asked all the time.
	cargo test --release --locked --test server -- --ignored --nocapture figures_of_a_hot_add

soak: onnxruntime ## Good, bad, slow and hostile clients at once for SOAK_MINUTES (30); writes docs/benchmarks/soak.md.
	POSED_BENCH_OUT=docs/benchmarks/soak.md cargo bench --locked --bench soak

FUZZ := bundle camera dataset form image manifest ply protobuf raw request
FUZZ_SECONDS := 15
fuzz: ## Fuzzes every reader of bytes from outside, each for FUZZ_SECONDS.
	@scripts/fuzz.sh $(FUZZ_SECONDS) $(FUZZ)

COMPARE := benches/compare/.venv
$(COMPARE)/.done: benches/compare/requirements.txt
	python3 -m venv $(COMPARE)
	$(COMPARE)/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

bench-pnp: onnxruntime $(COMPARE)/.done ## Compares the solver with OpenCV and PoseLib; writes docs/benchmarks/pnp.md.
	$(COMPARE)/bin/python benches/compare/pnp.py docs/benchmarks/pnp.md

SERVERS := benches/compare/serve
$(SERVERS)/.venv-%/.done: $(SERVERS)/requirements-%.txt
	python3 -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

# Triton is for some processors alone; the rest goes on without it.
SPLIT ?=
bench-compare: onnxruntime build $(SERVERS)/.venv-cpu/.done $(SERVERS)/.venv-openvino/.done ## Compares the server with FastAPI and Triton around the same networks (SPLIT: a BOP split); writes docs/benchmarks/compare.md.
	-$(MAKE) --no-print-directory $(SERVERS)/.venv-triton/.done
	$(SERVERS)/.venv-cpu/bin/python $(SERVERS)/compare.py docs/benchmarks/compare.md $(if $(SPLIT),--split $(SPLIT)) $(COMPARE_FLAGS)

VENV := training/.venv
UV := 0.13.9
$(VENV)/.done: training/requirements.txt training/pyproject.toml
	python3 -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check uv==$(UV)
	$(VENV)/bin/uv pip install --quiet --python $(VENV)/bin/python -r training/requirements.txt
	$(VENV)/bin/uv pip install --quiet --python $(VENV)/bin/python --no-deps --editable training
	touch $@

train-env: $(VENV)/.done ## Installs the trainer.

train-test: train-env ## Runs the trainer's lints and tests.
	cd training && .venv/bin/ruff check . && .venv/bin/ruff format --check . && .venv/bin/python -m pytest -q

BLENDER := training/.venv-blender
$(BLENDER)/.done: training/requirements-blender.txt $(VENV)/.done
	python3 -m venv $(BLENDER)
	$(VENV)/bin/uv pip install --quiet --python $(BLENDER)/bin/python -r training/requirements-blender.txt
	$(VENV)/bin/uv pip install --quiet --python $(BLENDER)/bin/python --no-deps --editable training
	touch $@

render-env: $(BLENDER)/.done ## Installs Blender for the photoreal renderer.

# Scenes that no training and no choice has seen: `rendered/` has numbers below 1,000, what the demo nets were trained on
# below 110,000 (training/train-demo.sh).
FRESH ?= .fresh
RENDER := training/.venv-blender/bin/python -m posed_train.render.command training/demo/models

fresh-scenes: $(BLENDER)/.done ## Renders fresh scenes of the demo objects into $(FRESH); goes on where it was (an hour on two cores).
	$(RENDER) $(FRESH)/single --engine cycles --views 1 --scenes 160 --first 200000
	$(RENDER) $(FRESH)/views --engine cycles --views 8 --scenes 20 --first 210000

evaluate-fresh: onnxruntime build ## Scores the shipped models on the fresh scenes; writes report.html and report.json there.
	target/release/posed evaluate cube bracket motor link --split $(FRESH)/single --split $(FRESH)/views \
		--meshes training/demo/models --detector --html $(FRESH)/report.html --json $(FRESH)/report.json

films: $(VENV)/.done ## Renders a film of a still scene and one with a moving object into $(FRESH) (six minutes on two cores).
	$(VENV)/bin/posed-train render training/demo/models $(FRESH)/still --scenes 1 --views 300 --first 220000 --film still
	$(VENV)/bin/posed-train render training/demo/models $(FRESH)/moving --scenes 1 --views 300 --first 220001 --film moving

evaluate-films: onnxruntime build ## Replays the films as streams that track.
	target/release/posed evaluate cube bracket motor link --split $(FRESH)/still --split $(FRESH)/moving \
		--meshes training/demo/models --stream
