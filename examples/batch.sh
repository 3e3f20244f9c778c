#!/usr/bin/env bash
# A nightly check: works on every log of a folder, and holds each run against the one of last time.
#
#     OPTIONS="--range 20" examples/batch.sh LOGS NEW.batch [OLD.batch]
#
# Each run that is also in OLD.batch gets a comparison.md. Exit code: 0; 1 where a log failed; else 4 where predictions
# became worse by more than 5 %, or can no longer be measured. Killed, it goes on where it was.
set -euo pipefail
shopt -s nullglob

logs=${1:?the folder with the logs}
new=${2:?the batch folder to write}
old=${3:-}
code=0

# shellcheck disable=SC2086 - OPTIONS are several words
adcbf batch "$logs"/*.mcap "$logs"/*.bag -o "$new" -- run ${OPTIONS:-} > /dev/null || code=$?
if ((code == 3)); then # part of a log was lost; what is left of it is worth a look all the same
    code=0
fi

# The options that fail where a metric became worse, for those metrics that the report has a value of.
limits() {
    python3 - "$1" later_seen.rmse_x_m later_seen.rmse_y_m <<'END'
import json, sys
metrics = json.load(open(sys.argv[1]))["metrics"]
for name in sys.argv[2:]:
    if metrics.get(name, {}).get("value") is not None:
        print("--fail-on", f"{name}>+5%")
END
}

if [[ -n $old ]]; then
    for run in "$new"/runs/log=*; do
        before=$old/runs/${run##*/}
        [[ -f $before/report.json && -f $run/report.json ]] || continue
        options=$(limits "$before/report.json")
        changed=0
        # shellcheck disable=SC2086 - several words here too
        adcbf compare "$before" "$run" --markdown "$run/comparison.md" $options > /dev/null || changed=$?
        if ((code == 0 || (code == 4 && changed != 0))); then
            code=$changed
        fi
    done
fi
exit "$code"
