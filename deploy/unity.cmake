# Several sources of a target are compiled as one: nearly all of a compiler's time goes to headers and templates that a
# target's files share. What one file has in its anonymous namespace no other of its target may have under the same name
# (tests/layering/single_names.py).

# Files per compilation at most, where the target's property HOROPTER_UNITY_FILES does not say otherwise: some 20 s and 1 GB
# each, and enough of them to keep a few cores busy.
set(HOROPTER_UNITY_FILES 16 CACHE STRING "Files compiled as one with HOROPTER_UNITY")
mark_as_advanced(HOROPTER_UNITY_FILES)

function(compile_in_batches directory)
  get_property(folders DIRECTORY ${directory} PROPERTY SUBDIRECTORIES)
  foreach(folder ${folders})
    compile_in_batches(${folder})
  endforeach()
  file(RELATIVE_PATH place ${CMAKE_SOURCE_DIR} ${directory})
  # Programs of one file, and reports, with names of their own.
  if(place MATCHES "^tests/(bench|diagnose)$" OR (place MATCHES "^tests" AND NOT HOROPTER_UNITY_TESTS) OR
     (NOT place MATCHES "^tests" AND NOT HOROPTER_UNITY))
    return()
  endif()
  get_property(targets DIRECTORY ${directory} PROPERTY BUILDSYSTEM_TARGETS)
  foreach(target ${targets})
    get_target_property(type ${target} TYPE)
    if(NOT type MATCHES "STATIC_LIBRARY|OBJECT_LIBRARY|EXECUTABLE")
      continue()
    endif()
    get_target_property(sources ${target} SOURCES)
    list(FILTER sources INCLUDE REGEX "\\.cc$")
    list(LENGTH sources count)
    get_target_property(most ${target} HOROPTER_UNITY_FILES)
    if(NOT most)
      set(most ${HOROPTER_UNITY_FILES})
    endif()
    # Batches of one size: one that is left over would be compiled alone.
    math(EXPR batches "(${count} + ${most} - 1) / ${most}")
    if(count GREATER 1)
      math(EXPR size "(${count} + ${batches} - 1) / ${batches}")
      set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE ${size})
      # Types in anonymous namespaces are members of ones that are not, in a source: in a batch the compiler takes it for a
      # header and warns of two definitions, which there are not.
      target_compile_options(${target} PRIVATE -Wno-subobject-linkage)
    endif()
  endforeach()
endfunction()
compile_in_batches(${CMAKE_SOURCE_DIR})
