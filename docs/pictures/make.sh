#!/bin/sh
# The pictures of the README: contact sheets of the default bundle. Needs `pip install ".[text,plot]"`.
set -eu
cd "$(dirname "$0")"
export PATH="$PWD/../../.venv/bin:$PATH"

kinegraph generate "an old person walks and turns left" --seconds 4 --seed 3 --force -o turn.png
kinegraph generate "a person raises both hands" --seconds 3 --seed 1 --force -o raise.png
kinegraph generate "a person walks forward and then bows" --seconds 6 --seed 2 --force -o sequence.png
kinegraph generate "a person walks forward while waving the right hand" --seconds 4 --seed 4 --force -o together.png
