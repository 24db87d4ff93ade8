#!/usr/bin/env bash
# Localize a long recording in shards as an array job of SLURM, then join them.
#
#     bash examples/shards_on_slurm.sh day boxes.parquet --scene scene.json --frame-rate 5
#
# The first argument is the folder of the results; the others are those of `catfree plan`. Recording,
# scene and results lie where all nodes see them. Run the same line again to repeat what failed:
# finished shards are skipped. Without SLURM the shards run one after another.
set -euo pipefail
catfree=${CATFREE:-catfree}
out=$(realpath -m "$1")
shift

$catfree plan "$@" --out "$out"
plan=$out/_shards/plan.json
last=$(($(grep -c '"index":' "$plan") - 1))

if command -v sbatch >/dev/null; then
  array=$(sbatch --parsable --array="0-$last" --cpus-per-task=1 --mem=2G --requeue \
    --wrap="$catfree shard --plan '$plan' --index \$SLURM_ARRAY_TASK_ID")
  sbatch --dependency="afterok:$array" --cpus-per-task=1 --mem=4G --wrap="$catfree join '$out'"
else
  for index in $(seq 0 "$last"); do
    $catfree shard --plan "$plan" --index "$index"
  done
  $catfree join "$out"
fi
