#!/bin/bash
# build.sh ROOT: build the clones in ROOT/src; takes seven minutes on two cores.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
export ROOT=$(cd "$1" && pwd)
src=$ROOT/src build=$ROOT/build jobs=${JOBS:-2}
unset ROS_ROOT
mkdir -p "$build" "$ROOT/log"

# quiet LOG COMMAND...: run a command; print the end of its output if it fails.
quiet() {
    local log=$ROOT/log/$1
    shift
    "$@" >>"$log" 2>&1 || { tail -5 "$log"; echo "failed: $log"; exit 1; }
}

# part NAME SOURCE [OPTIONS]: configure a part.
part() {
    local name=$1 source=$2
    shift 2
    echo "$(date +%T) $name"
    mkdir -p "$build/$name"
    cd "$build/$name"
    quiet "$name" cmake "$source" -DCMAKE_BUILD_TYPE=Release "$@"
}

# link NAME: put a part's libraries where CMake's targets of the next look for them.
link() { find "$build/$1" -name '*.so*' -exec ln -sf {} "$build/cisst/lib/" \;; }

# CMake fetches these itself; it takes the clones instead.
export GIT_CONFIG_GLOBAL=$ROOT/gitconfig
cat >"$GIT_CONFIG_GLOBAL" <<END
[url "$src/ReflexxesTypeII"]
    insteadOf = https://github.com/jhu-cisst-external/ReflexxesTypeII.git
[url "$src/clapack"]
    insteadOf = https://github.com/jhu-cisst-external/clapack
[url "$src/mechatronics-software"]
    insteadOf = https://github.com/jhu-cisst/mechatronics-software
[safe]
    directory = *
END
git -C "$src/ReflexxesTypeII" rev-parse -q --verify 1.2.6.p2 >/dev/null \
    || git -C "$src/ReflexxesTypeII" tag 1.2.6.p2 HEAD
amp=$src/sawRobotIO1394/core/components/code/Amp1394
[ -e "$amp/CMakeLists.txt" ] || { rm -rf "$amp"; git clone -q "$src/mechatronics-software" "$amp"; }

# The embedded Python shell needs wxWidgets: an empty class stands in for it.
kit=$src/sawIntuitiveResearchKit/core/components
sed -i '/^ *cisstInteractive$/d' "$kit/CMakeLists.txt"
sed -i "s|<cisstInteractive/ireTask.h>|\"$here/ireTask.h\"|" "$kit/code/system.cpp"

# Setup joints of an Si need gattlib, which CMake would fetch: functions that never connect stand in.
sed -i -e '/ExternalProject_Add (gattlib/,/^ *)$/d' -e '/set (gattlib_LIBRARIES/d' \
    -e '/add_dependencies.*gattlibExternal/d' "$kit/CMakeLists.txt"
sed -i "s|<gattlib.h>|\"$here/gattlib.h\"|" "$kit/code/mtsIntuitiveResearchKitSUJSi.cpp"

# Without optimisation: CLAPACK's slamch and dlamch measure the arithmetic and may not be optimised.
part netlib "$src/cisstNetlib" -DCMAKE_BUILD_TYPE= -DCMAKE_INSTALL_PREFIX="$ROOT/install"
quiet netlib make -j"$jobs"
quiet netlib make install

part cisst "$src/cisst" -DCISST_USE_SI_UNITS=ON -DCISST_BUILD_SHARED_LIBS=ON \
    -DCISST_HAS_QT5=OFF -DCISST_HAS_FLTK=OFF -DCISST_HAS_OPENGL=OFF -DCISST_HAS_JSON=ON \
    -DCISST_XML_LIB=LibXml2 -DCISST_cisstCommonXML=ON -DCISST_HAS_CISSTNETLIB=ON \
    -DCISST_cisstRobot=ON -DCISST_ROB_HAS_REFLEXXES_TYPEII=ON \
    -DCisstNetlib_DIR="$ROOT/install/share/cisstNetlib"
quiet cisst make -j"$jobs" cisstCommonXML cisstParameterTypes cisstNumerical cisstRobot
cisst=-Dcisst_DIR=$build/cisst

part speech "$src/sawTextToSpeech/components" "$cisst"
quiet speech make -j"$jobs"
link speech
part controllers "$here/controllers" "$cisst"
quiet controllers make -j"$jobs" -k
link controllers
part io "$src/sawRobotIO1394/core/components" "$cisst"
quiet io make -j"$jobs" sawRobotIO1394
parts=(
    -DsawTextToSpeech_DIR="$build/speech"
    -DsawControllers_DIR="$build/controllers/components"
    -DsawRobotIO1394_DIR="$build/io"
)
part kit "$kit" "$cisst" "${parts[@]}" -DsawIntuitiveResearchKit_HAS_SUJ_Si=ON \
    -DsawIntuitiveResearchKit_HAS_HID_HEAD_SENSOR=OFF
quiet kit make -j"$jobs"
link kit

echo "$(date +%T) messages"
messages=$ROOT/messages
include=(-Icrtk_msgs:"$src/crtk_msgs/msg" -Icisst_msgs:"$src/cisst-ros/cisst_msgs/msg")
for package in std_msgs geometry_msgs sensor_msgs; do
    include+=(-I"$package:/usr/share/$package/msg")
done
for folder in "$src/crtk_msgs" "$src/cisst-ros/cisst_msgs"; do
    package=$(basename "$folder")
    python=$messages/python/$package
    mkdir -p "$messages/include/$package" "$python/msg" "$python/srv"
    touch "$python/__init__.py"
    for file in "$folder"/msg/*.msg "$folder"/srv/*.srv; do
        quiet messages /usr/bin/python3 /usr/lib/gencpp/gen_cpp.py "$file" "${include[@]}" \
            -p "$package" -o "$messages/include/$package" -e /usr/share/gencpp
    done
    for kind in msg srv; do
        generate=(/usr/bin/python3 "/usr/lib/genpy/gen${kind}_py.py" "${include[@]}")
        generate+=(-p "$package" -o "$python/$kind")
        quiet messages "${generate[@]}" "$folder/$kind"/*."$kind"
        quiet messages "${generate[@]}" --initpy
    done
done

part bridge "$here/bridge" "$cisst" "${parts[@]}" -DsawIntuitiveResearchKit_DIR="$build/kit"
quiet bridge make -j"$jobs" -k
