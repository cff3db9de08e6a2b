#!/bin/sh
# Make the pictures of README and docs with the default bundle.
# Needs `pip install ".[text,plot,play,browser]"` and a chromium.
set -eu
cd "$(dirname "$0")"
python="${PYTHON:-../../.venv/bin/python}"
kinegraph() { "$python" -m kinegraph "$@" --force; }

# docs/python.md
kinegraph generate "an old person walks and turns left" --seconds 4 --seed 3 -o turn.png
kinegraph sequence "a person walks forward" "a person bows" --seconds 3 --seed 2 -o sequence.png
# README.md
kinegraph generate "a person walks forward while waving the right hand" --seconds 4 --seed 9 -o together.gif
# docs/graph.md
kinegraph parse "a person walks and turns right" --weight "right=0.5" --svg graph.svg
kinegraph generate "a person walks and turns right" --seconds 4 --seed 6 --weight "right=0.5" -o graph_less.png
kinegraph generate "a person walks and turns right" --seconds 4 --seed 6 -o graph_more.png
# README.md, docs/cli.md: play.jpg, phone.jpg, view.jpg
"$python" pages.py
# docs/characters.md
"$python" characters.py
# docs/constraints.md
"$python" constraints.py
# docs/timelines.md
"$python" timelines.py
# docs/evaluation.md
"$python" actions.py
# docs/composition.md
kinegraph compose --and "a person walks forward" --and "a person raises both hands" --seconds 4 --seed 2 -o compose_walk.png
kinegraph compose --and "a person walks forward" --and "a person raises the left hand" --and "a person waves the right hand" --method parts --seconds 4 --seed 7 -o compose_parts.png
kinegraph compose --and "a person walks and turns left" --and "a person waves both hands" --seconds 4 --seed 2 -o compose_turn.png
kinegraph compose --and "a person walks and turns left while a person waves both hands" --not "a person waves both hands" --seconds 4 --seed 2 -o compose_not.png
# of this clip only the energies are kept
kinegraph compose --and "a person walks forward" --and "a person waves the right hand" --seconds 4 --seed 4 -o composed.npz --energy energy.png
rm composed.npz
