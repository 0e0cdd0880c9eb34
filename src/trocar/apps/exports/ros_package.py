"""What makes a folder a package of ROS 1 and ROS 2.

Source: REP 149 (package.xml, format 3), and the documentation of catkin and ament_cmake.
"""

from __future__ import annotations

from xml.sax.saxutils import escape

from trocar import __version__


def package_xml(package: str, title: str) -> str:
    """Return a package's manifest."""
    return PACKAGE_XML.format(package=package, version=__version__, title=escape(title))


def cmake_lists(package: str) -> str:
    """Return what catkin and ament build a package by: it installs what the folder has."""
    return CMAKE.format(package=package)


PACKAGE_XML = """<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>{version}</version>
  <description>{title}</description>
  <maintainer email="nobody@example.com">whoever exported it</maintainer>
  <license>BSD-3-Clause</license>
  <buildtool_depend condition="$ROS_VERSION == 1">catkin</buildtool_depend>
  <buildtool_depend condition="$ROS_VERSION == 2">ament_cmake</buildtool_depend>
  <exec_depend>robot_state_publisher</exec_depend>
  <export>
    <build_type condition="$ROS_VERSION == 1">catkin</build_type>
    <build_type condition="$ROS_VERSION == 2">ament_cmake</build_type>
  </export>
</package>
"""

CMAKE = """cmake_minimum_required(VERSION 3.8)
project({package})
file(GLOB models *.urdf)
if("$ENV{{ROS_VERSION}}" STREQUAL "1")
  find_package(catkin REQUIRED)
  catkin_package()
  set(share ${{CATKIN_PACKAGE_SHARE_DESTINATION}})
else()
  find_package(ament_cmake REQUIRED)
  set(share share/${{PROJECT_NAME}})
endif()
install(DIRECTORY rviz DESTINATION ${{share}})
install(DIRECTORY meshes DESTINATION ${{share}} OPTIONAL)
install(FILES ${{models}} DESTINATION ${{share}})
if(NOT "$ENV{{ROS_VERSION}}" STREQUAL "1")
  ament_package()
endif()
"""
