"""The completion scripts. Each asks adcbf itself, with the line up to the cursor, and is given a value and its
meaning a line; where adcbf has nothing to offer, the shell offers files.

What is asked is Typer's protocol for fish, from all three shells: it takes the line as it is.
"""

from __future__ import annotations

_BASH = r"""# Completion of adcbf for bash. Load it with: source <(adcbf completion bash)

_adcbf() {
    local line=${COMP_LINE:0:COMP_POINT} before value meaning
    # Readline starts a new word at = and :, adcbf does not: what stands before is not to be repeated.
    before=${line##*[[:space:]]}
    before=${before%"${before##*[=:]}"}
    [[ $COMP_WORDBREAKS == *=* && $COMP_WORDBREAKS == *:* ]] || before=
    COMPREPLY=()
    while IFS=$'\t' read -r value meaning; do
        if [[ -n $value ]]; then COMPREPLY+=("${value#"$before"}"); fi
    done < <(env _ADCBF_COMPLETE=complete_fish _TYPER_COMPLETE_FISH_ACTION=get-args \
        _TYPER_COMPLETE_ARGS="$line" "$1" 2>/dev/null)
    if [[ ${COMPREPLY[0]-} == *= ]]; then compopt -o nospace 2>/dev/null; fi
}

complete -o default -F _adcbf adcbf
"""

_ZSH = r"""#compdef adcbf
# Completion of adcbf for zsh. Load it, after compinit, with: source <(adcbf completion zsh)
# or keep it as _adcbf in a folder of $fpath.

_adcbf() {
    local value meaning
    local -a keys values
    while IFS=$'\t' read -r value meaning; do
        if [[ $value == *= ]]; then
            keys+=("${value//:/\\:}${meaning:+:$meaning}")
        elif [[ -n $value ]]; then
            values+=("${value//:/\\:}${meaning:+:$meaning}")
        fi
    done < <(env _ADCBF_COMPLETE=complete_fish _TYPER_COMPLETE_FISH_ACTION=get-args \
        _TYPER_COMPLETE_ARGS="${(j: :)words[1,CURRENT-1]} $PREFIX" $words[1] 2>/dev/null)
    if (( $#keys + $#values == 0 )); then
        _files
    else
        (( $#keys )) && _describe 'setting' keys -S ''
        (( $#values )) && _describe 'value' values
    fi
}

if [[ $zsh_eval_context[-1] == loadautofunc ]]; then
    _adcbf "$@"
else
    compdef _adcbf adcbf
fi
"""

_FISH = r"""# Completion of adcbf for fish. Keep it as ~/.config/fish/completions/adcbf.fish

function __adcbf_offers
    set -l command (commandline --tokenize --cut-at-cursor --current-process)[1]
    set -l offers (env _ADCBF_COMPLETE=complete_fish _TYPER_COMPLETE_FISH_ACTION=get-args \
        _TYPER_COMPLETE_ARGS=(commandline --cut-at-cursor --current-process) $command 2>/dev/null \
        | string match --regex '.+')
    if test (count $offers) -gt 0
        printf '%s\n' $offers
    else
        __fish_complete_path (commandline --current-token --cut-at-cursor)
    end
end

complete --command adcbf --no-files --arguments '(__adcbf_offers)'
"""

SCRIPTS = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}
