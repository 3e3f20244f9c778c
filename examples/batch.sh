#!/usr/bin/env bash
# A nightly check: works on every log of a folder, and holds each run against the one of last time.
#
#     OPTIONS="--range 20" examples/batch.sh LOGS NEW.batch [OLD.batch]
#
# Each run that is also in OLD.batch gets a comparison.md. Exit code: 0; 1 where a log failed; 4 where predictions became
# worse by more than 5 %. Killed, it goes on where it was.
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

if [[ -n $old ]]; then
    for run in "$new"/runs/log=*; do
        before=$old/runs/${run##*/}
        [[ -f $before/report.json && -f $run/report.json ]] || continue
        adcbf compare "$before" "$run" --markdown "$run/comparison.md" \
            --fail-on 'later_seen.rmse_x_m>+5%' --fail-on 'later_seen.rmse_y_m>+5%' > /dev/null || code=$?
    done
fi
exit "$code"
