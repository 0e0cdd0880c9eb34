"""Small robots as other tools write them."""

from __future__ import annotations

URDF = """<robot name="three joints">
 <material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
 <link name="base"><visual><geometry><box size="0.2 0.2 0.1"/></geometry>
  <material name="red"/></visual></link>
 <link name="upper"><inertial><origin xyz="0 0 0.15"/><mass value="1.2"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><origin xyz="0 0 0.15"/><geometry><cylinder radius="0.03" length="0.3"/></geometry>
  </visual><collision><origin xyz="0 0 0.15" rpy="0.1 0.2 0.3"/>
  <geometry><cylinder radius="0.03" length="0.3"/></geometry></collision></link>
 <link name="fore"><inertial><origin xyz="0 0 0.1" rpy="0.3 0 0"/><mass value="0.6"/>
  <inertia ixx="0.004" iyy="0.005" izz="0.002" ixy="0.0001" ixz="0" iyz="0"/></inertial></link>
 <link name="finger"><inertial><mass value="0.1"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
 <link name="thumb"><inertial><mass value="0.1"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
 <joint name="shoulder" type="revolute"><origin xyz="0 0 0.05" rpy="0.2 -0.4 1.1"/>
  <parent link="base"/><child link="upper"/><axis xyz="1 2 -1"/>
  <limit lower="-1" upper="2" effort="20" velocity="3"/><dynamics damping="0.2" friction="0.1"/>
 </joint>
 <joint name="elbow" type="continuous"><origin xyz="0 0 0.3"/><parent link="upper"/>
  <child link="fore"/><axis xyz="0 1 0"/></joint>
 <joint name="grip" type="prismatic"><origin xyz="0.01 0 0.2"/><parent link="fore"/>
  <child link="finger"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.04" effort="30" velocity="0.1"/></joint>
 <joint name="grip2" type="prismatic"><origin xyz="-0.01 0 0.2"/><parent link="fore"/>
  <child link="thumb"/><axis xyz="1 0 0"/>
  <limit lower="-0.1" upper="0.1" effort="30" velocity="0.1"/>
  <mimic joint="grip" multiplier="-1" offset="-0.002"/></joint>
</robot>"""

#: Two uprights on a base and a bar between their tops, which are 0.1 m above the base; the right
#: upright stands on a block of {block} m, so that it is shorter.
SDF = """<sdf version="1.7"><model name="bars"><pose>1 2 3 0 0 0.5</pose>
 <link name="base"/>
 <link name="left"><pose>0 0 0 0 0 0</pose><inertial><mass>0.1</mass><inertia><ixx>1e-4</ixx>
  <iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link>
 <link name="right"><pose>0.2 0 {block} 0 0 0</pose><inertial><mass>0.1</mass><inertia>
  <ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link>
 <link name="bar"><pose relative_to="left">0 0 0.1 0 0.3 0</pose><inertial><mass>0.1</mass>
  <inertia><ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link>
 <joint name="crank" type="revolute"><parent>base</parent><child>left</child>
  <axis><xyz>0 1 0</xyz><limit><lower>-0.4</lower><upper>0.4</upper><effort>5</effort></limit>
  </axis></joint>
 <joint name="rocker" type="revolute"><parent>base</parent><child>right</child>
  <axis><xyz>0 1 0</xyz></axis></joint>
 <joint name="top" type="revolute"><parent>left</parent><child>bar</child>
  <axis><xyz expressed_in="__model__">0 2 0</xyz></axis></joint>
 <joint name="closing" type="revolute"><pose relative_to="right">0 0 {rest} 0 0 0</pose>
  <parent>right</parent><child>bar</child><axis><xyz>0 1 0</xyz></axis></joint>
</model></sdf>"""
#: The same as MJCF.
MJCF = """<mujoco model="bars"><compiler angle="radian"/><worldbody>
 <body name="left"><joint name="crank" axis="0 1 0" range="-0.4 0.4"/>
  <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.004" mass="0.1"/>
  <body name="bar" pos="0 0 0.1" euler="0 0.3 0"><joint name="top" axis="0 1 0"/>
   <geom type="box" size="0.02 0.004 0.004" mass="0.1"/>
   <site name="end" pos="0.19106729782512123 0 0.059104041332267915"/></body></body>
 <body name="right" pos="0.2 0 {block}"><joint name="rocker" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 {rest}" size="0.004" mass="0.1"/>
  <site name="peak" pos="0 0 {rest}"/></body></worldbody>
 <equality><connect name="closing" site1="peak" site2="end"/></equality>
 <actuator><motor joint="crank" forcerange="-2 2" forcelimited="true"/></actuator></mujoco>"""
