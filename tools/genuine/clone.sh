#!/bin/bash
# clone.sh SRC: clone upstream's repositories at the commits that answers were recorded with.
set -eu
mkdir -p "$1"
cd "$1"
while read -r owner name commit; do
    [ -d "$name" ] || git clone -q "https://github.com/$owner/$name"
    git -C "$name" checkout -q "$commit"
done <<'END'
jhu-cisst cisst fe84bf08
jhu-cisst cisstNetlib 9112629
jhu-cisst cisst-ros 73aca61
jhu-cisst mechatronics-software 8e6a4f7
jhu-cisst-external ReflexxesTypeII 09d4a63
jhu-cisst-external clapack 93ef9f8
jhu-saw sawControllers f98b6a8
jhu-saw sawRobotIO1394 630dcbf
jhu-saw sawTextToSpeech c4c3c3b
jhu-dvrk sawIntuitiveResearchKit 9e535e68
collaborative-robotics crtk_msgs 14b04fc
END
