#!/bin/sh
# The pictures of the README, by the default bundle. Needs `pip install ".[text,plot,play,browser]"` and a chromium.
set -eu
cd "$(dirname "$0")"
kinegraph() { "${PYTHON:-../../.venv/bin/python}" -m kinegraph.cli "$@" --force; }

kinegraph generate "an old person walks and turns left" --seconds 4 --seed 3 -o turn.png
kinegraph generate "a person walks forward while waving the right hand" --seconds 4 --seed 4 -o together.gif
kinegraph sequence "a person walks forward" "a person bows" --seconds 3 --seed 2 -o sequence.png
kinegraph parse "a tired person walks and turns to the right" --weight "to the right=0.3" --svg graph.svg
kinegraph generate "a tired person walks and turns to the right" --seconds 4 --seed 6 --weight "to the right=0.3" -o graph_less.png
kinegraph generate "a tired person walks and turns to the right" --seconds 4 --seed 6 -o graph_more.png
"${PYTHON:-../../.venv/bin/python}" pages.py
# the map alone is kept: of the clip there is a GIF already
kinegraph compose --and "a person walks forward" --and "a person waves the right hand" --seconds 4 --seed 4 -o composed.npz --energy energy.png
rm composed.npz
