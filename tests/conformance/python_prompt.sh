#!/usr/bin/env bash
# Types what sim_plant/PYTHON.md shows at a Python prompt, against a plant of its own, and compares what is printed.
#
# usage: tests/conformance/python_prompt.sh
# SINEW_PLANT names a built sim_plant; ./python says where the packages come from.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
target="${CARGO_TARGET_DIR:-target}"
plant="${SINEW_PLANT:-}"
if [ -z "$plant" ]; then
    # The selection of packages decides their features: another one than the tests' would compile everything again.
    cargo build -q --workspace --bins --example canopen_bench
    plant="$target/debug/sim_plant"
fi
python=$(tests/conformance/python)
folder=$(mktemp -d)
pid=""
trap '[ -z "$pid" ] || { kill "$pid" 2>/dev/null || true; wait "$pid" 2>/dev/null || true; }; rm -rf "$folder"' EXIT
# A bus and a port of its own: a plant started by hand may be running.
sed "s/\"sinew0\"/\"py$$\"/" config/drives.toml >"$folder/drives.toml"
"$plant" --socketcand 0 --config config/arm.toml config/controller.toml "$folder/drives.toml" config/plant.toml \
    >"$folder/plant.log" 2>&1 &
pid=$!
for _ in $(seq 600); do
    grep -q "drives on" "$folder/plant.log" && break
    kill -0 "$pid" 2>/dev/null || { cat "$folder/plant.log" >&2 && exit 1; }
    sleep 0.1
done
port=$(sed -n 's/^sim_plant: socketcand on .*:\([0-9]*\)$/\1/p' "$folder/plant.log")
[ -n "$port" ] || { cat "$folder/plant.log" >&2 && exit 1; }
sed "s/29536/$port/" sim_plant/PYTHON.md >"$folder/PYTHON.md"
count=$(grep -c '^>>> ' "$folder/PYTHON.md")
[ "$count" -gt 30 ] || { echo "only $count prompts in sim_plant/PYTHON.md" >&2 && exit 1; }
"$python" -m doctest -o ELLIPSIS "$folder/PYTHON.md"
echo "sim_plant/PYTHON.md: $count prompts, all as printed"
