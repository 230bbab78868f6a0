# SPDX-License-Identifier: Apache-2.0
# Compile the hot path with mypyc, as setup.py states, and install it beside the Python sources of the wheel.
# It runs in a folder without pyproject.toml, or scikit-build-core would hook setuptools and start CMake once more.
# Only for pip: in colcon's build of the Python package, scikit-build-core runs CMake without a place for wheels.
if(NOT SKBUILD_PLATLIB_DIR)
  return()
endif()
get_filename_component(tree "${CMAKE_CURRENT_LIST_DIR}/.." ABSOLUTE)
set(compile "${CMAKE_BINARY_DIR}/compile")
file(MAKE_DIRECTORY "${compile}")
file(CREATE_LINK "${tree}/scara_effmass" "${compile}/scara_effmass" SYMBOLIC)
add_custom_target(hot_path ALL
  COMMAND "${Python3_EXECUTABLE}" "${tree}/setup.py" --quiet build_ext --build-lib lib
  WORKING_DIRECTORY "${compile}"
)
install(DIRECTORY "${compile}/lib/" DESTINATION "${SKBUILD_PLATLIB_DIR}")
