# One precompiled header for what is shipped and one for the tests, of targets whose files are compiled one by one: a build
# without a compiler cache spends half of its time on reading the same headers. Off by default, so that a header somebody forgot to include is seen.
add_library(precompiled OBJECT deploy/precompiled.cc)
target_link_libraries(precompiled PRIVATE Eigen3::Eigen absl::status absl::statusor absl::strings absl::span Threads::Threads)
target_precompile_headers(precompiled PRIVATE
  <Eigen/Dense> <algorithm> <array> <chrono> <cmath> <functional> <iostream> <limits> <map> <memory> <mutex> <numeric>
  <optional> <random> <sstream> <string> <thread> <unordered_map> <utility> <vector> <absl/status/status.h>
  <absl/status/statusor.h> <absl/strings/str_cat.h> <absl/types/span.h>)

if(HOROPTER_TESTS)
  add_library(precompiled_tests OBJECT deploy/precompiled.cc)
  target_link_libraries(precompiled_tests PRIVATE Eigen3::Eigen absl::status absl::statusor absl::strings absl::span
    GTest::gtest GTest::gmock Threads::Threads)
  target_compile_options(precompiled_tests PRIVATE $<$<CONFIG:Release>:-O1>)
  target_precompile_headers(precompiled_tests PRIVATE
    <gmock/gmock.h> <gtest/gtest.h>
    <Eigen/Dense> <algorithm> <array> <chrono> <cmath> <functional> <iostream> <limits> <map> <memory> <mutex> <numeric>
    <optional> <random> <sstream> <string> <thread> <unordered_map> <utility> <vector> <absl/status/status.h>
    <absl/status/statusor.h> <absl/strings/str_cat.h> <absl/types/span.h>)
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
    get_target_property(batches ${target} UNITY_BUILD)
    # In a batch headers are read once anyway. The generated code of the wire is compiled without warnings, the precompiled header with.
    if(NOT type MATCHES "STATIC_LIBRARY|EXECUTABLE" OR target MATCHES "^precompiled" OR target STREQUAL "horopter_proto" OR batches)
      continue()
    endif()
    # Some know nothing of Eigen.
    target_include_directories(${target} SYSTEM PRIVATE $<TARGET_PROPERTY:Eigen3::Eigen,INTERFACE_INCLUDE_DIRECTORIES>)
    if("GTest::gtest" IN_LIST libraries)
      target_precompile_headers(${target} REUSE_FROM precompiled_tests)
    else()
      target_precompile_headers(${target} REUSE_FROM precompiled)
    endif()
  endforeach()
endfunction()
use_precompiled_headers(${CMAKE_SOURCE_DIR})
