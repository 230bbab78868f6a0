# SPDX-License-Identifier: Apache-2.0
# Build msg_schemas against the ROS wheels of PyPI: pass this file to CMake as CMAKE_PROJECT_INCLUDE.
# A workspace with an installed ROS does not need it.

find_package(Python3 REQUIRED COMPONENTS Interpreter)
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
    "import ament_package, pathlib; print(pathlib.Path(ament_package.__file__).resolve().parents[4])"
  OUTPUT_VARIABLE ROS_WHEELS_PREFIX
  OUTPUT_STRIP_TRAILING_WHITESPACE
  COMMAND_ERROR_IS_FATAL ANY
)
set(ENV{AMENT_PREFIX_PATH} "${ROS_WHEELS_PREFIX}")
list(PREPEND CMAKE_PREFIX_PATH "${ROS_WHEELS_PREFIX}")

# The imported targets of the wheels contain an include directory of the machine that built them.
function(drop_missing_include_directories)
  get_directory_property(targets IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(directories)
      list(FILTER directories EXCLUDE REGEX "^/opt/python/")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${directories}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL drop_missing_include_directories)

if(PROJECT_NAME STREQUAL "scara_effmass_msgs")
  # rclpy with Fast DDS uses only these; the code for C++ would take half of the time.
  find_package(rosidl_default_generators REQUIRED)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces INCLUDE REGEX
    "^rosidl_(generator_(type_description|c|py)|typesupport_(c|fastrtps_c|introspection_c)):")

  # Their files include the same large headers, so one file per target compiles faster than one per message.
  function(unite_typesupports)
    list(TRANSFORM AMENT_EXTENSIONS_rosidl_generate_idl_interfaces REPLACE ":.*" "" OUTPUT_VARIABLE targets)
    list(FILTER targets INCLUDE REGEX "typesupport")
    list(TRANSFORM targets PREPEND "scara_effmass_msgs__")
    set_target_properties(${targets} PROPERTIES UNITY_BUILD ON)
  endfunction()
  cmake_language(DEFER CALL unite_typesupports)

  # control_msgs has no wheel. A workspace takes it from its ROS, as package.xml says.
  if(SKBUILD_PLATLIB_DIR)
    set(CMAKE_PROJECT_INCLUDE "${CMAKE_CURRENT_LIST_FILE}")
    add_subdirectory("${CMAKE_CURRENT_LIST_DIR}/control_msgs" control_msgs)
  endif()
endif()
