# Precompiled headers of targets whose files are compiled one by one: one for what is shipped, one for what deploy/optimization.cmake
# names, one for the tests. A build without a compiler cache spends half of its time on reading the same headers. Off by default, so that
# a header somebody forgot to include is seen.
set(common_headers <Eigen/Dense> <algorithm> <array> <chrono> <cmath> <functional> <iostream> <limits> <map> <memory> <mutex> <numeric>
  <optional> <random> <sstream> <string> <thread> <unordered_map> <utility> <vector> <absl/status/status.h>
  <absl/status/statusor.h> <absl/strings/str_cat.h> <absl/types/span.h>)

# precompiled_headers(NAME HEADER...): with the options that the target NAME has got when it is called.
function(precompiled_headers name)
  add_library(${name} OBJECT deploy/precompiled.cc)
  target_link_libraries(${name} PRIVATE Eigen3::Eigen absl::status absl::statusor absl::strings absl::span Threads::Threads)
  target_precompile_headers(${name} PRIVATE ${ARGN} ${common_headers})
endfunction()
precompiled_headers(precompiled)
# Of what deploy/optimization.cmake names.
precompiled_headers(precompiled_cold <grpcpp/grpcpp.h>)
target_compile_options(precompiled_cold PRIVATE $<$<CONFIG:Release>:-O1>)
if(HOROPTER_TESTS)
  precompiled_headers(precompiled_tests <gmock/gmock.h> <gtest/gtest.h>)
  target_link_libraries(precompiled_tests PRIVATE GTest::gtest GTest::gmock)  # their definitions
  target_compile_options(precompiled_tests PRIVATE $<$<CONFIG:Release>:-O1>)
endif()

function(use_precompiled_headers directory)
  get_property(folders DIRECTORY ${directory} PROPERTY SUBDIRECTORIES)
  foreach(folder ${folders})
    use_precompiled_headers(${folder})
  endforeach()
  get_property(targets DIRECTORY ${directory} PROPERTY BUILDSYSTEM_TARGETS)
  foreach(target ${targets})
    get_target_property(type ${target} TYPE)
    get_target_property(libraries ${target} LINK_LIBRARIES)
    get_target_property(options ${target} COMPILE_OPTIONS)
    get_target_property(batches ${target} UNITY_BUILD)
    # In a batch headers are read once anyway. The generated code of the wire is compiled without warnings, the precompiled header with.
    if(NOT type MATCHES "STATIC_LIBRARY|EXECUTABLE" OR target MATCHES "^precompiled" OR target STREQUAL "horopter_proto" OR batches)
      continue()
    endif()
    # Some know nothing of Eigen.
    target_include_directories(${target} SYSTEM PRIVATE $<TARGET_PROPERTY:Eigen3::Eigen,INTERFACE_INCLUDE_DIRECTORIES>)
    if("GTest::gtest" IN_LIST libraries)
      target_precompile_headers(${target} REUSE_FROM precompiled_tests)
    elseif(options MATCHES "-O1")
      target_precompile_headers(${target} REUSE_FROM precompiled_cold)
    else()
      target_precompile_headers(${target} REUSE_FROM precompiled)
    endif()
  endforeach()
endfunction()
use_precompiled_headers(${CMAKE_SOURCE_DIR})
