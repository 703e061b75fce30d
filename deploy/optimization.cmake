# What is read and written once a request or once a command, where nobody would notice a faster loop: with less optimization its
# compilation takes three quarters. What goes over pixels, meshes or evidence is not among it. Values stay the same.
foreach(target db service horopterd bop_dataset horopter_client camera_file load horopter)
  target_compile_options(${target} PRIVATE $<$<CONFIG:Release>:-O1>)
endforeach()
