#!/bin/sh
# Fuzzes some targets, each for so many seconds: scripts/fuzz.sh SECONDS TARGET...
set -eu
cd "$(dirname "$0")/../fuzz"
seconds=$1
shift
# What cargo-fuzz passes, but for the sanitizer, which needs an unstable compiler. A folder of its own: these flags make
# all crates anew.
coverage='-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters
    -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares'
RUSTFLAGS="--cfg fuzzing $(echo $coverage)" cargo build --locked --release --target "$(rustc -vV | sed -n 's/host: //p')" \
    --target-dir target
for target in "$@"; do
    mkdir -p "corpus/$target" "artifacts/$target"
    echo "fuzzing $target for $seconds s"
    # shellcheck disable=SC2046 # Seeds are there or not.
    target/*/release/"$target" -max_total_time="$seconds" -rss_limit_mb=2048 -timeout=10 -max_len=65536 -print_final_stats=1 \
        -artifact_prefix="artifacts/$target/" "corpus/$target" $(ls -d "seeds/$target" 2>/dev/null || true) 2>"artifacts/$target/log" || {
        tail -n 40 "artifacts/$target/log"
        exit 1
    }
    grep -E 'stat::(number_of_executed_units|peak_rss_mb)' "artifacts/$target/log"
done
