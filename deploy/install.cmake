# What is installed, in four components: server, client, dev (C++: find_package(horopter_client)) and python.
include(GNUInstallDirs)
set(CMAKE_SKIP_INSTALL_ALL_DEPENDENCY ON)  # tests and benchmarks need not be built for it

# Every option with its default and what it does.
add_custom_command(OUTPUT ${CMAKE_BINARY_DIR}/horopterd.toml
  COMMAND horopterd --print-config > ${CMAKE_BINARY_DIR}/horopterd.toml
  DEPENDS horopterd VERBATIM)
# Manual pages and completion, from the programs' own words.
foreach(word manual completion)
  set(page ${CMAKE_BINARY_DIR}/horopter.${word})
  add_custom_command(OUTPUT ${page} COMMAND horopter ${word} > ${page} DEPENDS horopter VERBATIM)
endforeach()
find_package(Python3 REQUIRED COMPONENTS Interpreter)
add_custom_command(OUTPUT ${CMAKE_BINARY_DIR}/horopterd.manual
  COMMAND ${Python3_EXECUTABLE} -B ${CMAKE_SOURCE_DIR}/deploy/server_manual.py $<TARGET_FILE:horopterd> > ${CMAKE_BINARY_DIR}/horopterd.manual
  DEPENDS horopterd ${CMAKE_SOURCE_DIR}/deploy/server_manual.py VERBATIM)
add_custom_target(sample_config DEPENDS ${CMAKE_BINARY_DIR}/horopterd.toml ${CMAKE_BINARY_DIR}/horopterd.manual
  ${CMAKE_BINARY_DIR}/horopter.manual ${CMAKE_BINARY_DIR}/horopter.completion)

install(TARGETS horopterd RUNTIME COMPONENT server)
install(FILES ${CMAKE_BINARY_DIR}/horopterd.toml DESTINATION /etc/horopter COMPONENT server)
install(FILES deploy/horopterd.service DESTINATION /lib/systemd/system COMPONENT server)
install(PROGRAMS deploy/credentials.sh DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT server)
install(FILES docs/cell.md deploy/grafana/horopter.json deploy/grafana/prometheus.yml
  DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT server)

install(FILES ${CMAKE_BINARY_DIR}/horopterd.manual DESTINATION ${CMAKE_INSTALL_MANDIR}/man8 RENAME horopterd.8 COMPONENT server)

install(TARGETS horopter RUNTIME COMPONENT client)
install(FILES ${CMAKE_BINARY_DIR}/horopter.manual DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 RENAME horopter.1 COMPONENT client)
install(FILES ${CMAKE_BINARY_DIR}/horopter.completion DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions
  RENAME horopter COMPONENT client)

install(TARGETS horopter_client horopter_proto base ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}/horopter COMPONENT dev)
set(headers ${CMAKE_INSTALL_INCLUDEDIR}/horopter_client)
install(FILES client/api.h client/channel.h client/convert.h DESTINATION ${headers}/client COMPONENT dev)
install(FILES server/base/status_macros.h DESTINATION ${headers}/server/base COMPONENT dev)
install(FILES server/vision/geometry/object_model.h server/vision/geometry/rigid3.h
  DESTINATION ${headers}/server/vision/geometry COMPONENT dev)
install(DIRECTORY ${CMAKE_BINARY_DIR}/proto/gen/horopter DESTINATION ${headers} COMPONENT dev
  FILES_MATCHING PATTERN "*.pb.h")
install(DIRECTORY proto/horopter DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/proto COMPONENT dev
  FILES_MATCHING PATTERN "*.proto")
include(CMakePackageConfigHelpers)
set(config ${CMAKE_INSTALL_LIBDIR}/cmake/horopter_client)
configure_package_config_file(deploy/horopter_clientConfig.cmake.in ${CMAKE_BINARY_DIR}/horopter_clientConfig.cmake
  INSTALL_DESTINATION ${config} PATH_VARS CMAKE_INSTALL_LIBDIR CMAKE_INSTALL_INCLUDEDIR)
write_basic_package_version_file(${CMAKE_BINARY_DIR}/horopter_clientConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/horopter_clientConfig.cmake ${CMAKE_BINARY_DIR}/horopter_clientConfigVersion.cmake
  DESTINATION ${config} COMPONENT dev)

install(DIRECTORY ${CMAKE_BINARY_DIR}/client/python/horopter DESTINATION lib/python3/dist-packages COMPONENT python
  PATTERN "__pycache__" EXCLUDE)

set(CPACK_PACKAGE_NAME horopter)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_CONTACT "Horopter <horopter@example.org>")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "Recognises known parts in images from uncalibrated cameras")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_SET_DESTDIR OFF)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL server client dev python)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_ENABLE_COMPONENT_DEPENDS OFF)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_SERVER_PACKAGE_NAME horopter-server)
set(CPACK_DEBIAN_SERVER_PACKAGE_SHLIBDEPS ON)
file(WRITE ${CMAKE_BINARY_DIR}/debian/conffiles "/etc/horopter/horopterd.toml\n")
set(CPACK_DEBIAN_SERVER_PACKAGE_CONTROL_EXTRA ${CMAKE_BINARY_DIR}/debian/conffiles)
set(CPACK_DEBIAN_CLIENT_PACKAGE_NAME horopter-client)
set(CPACK_DEBIAN_CLIENT_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_DEV_PACKAGE_NAME horopter-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS "libgrpc++-dev, libprotobuf-dev, libabsl-dev, libeigen3-dev")
set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-horopter)
set(CPACK_DEBIAN_PYTHON_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "python3, python3-grpcio, python3-protobuf, python3-numpy")
include(CPack)
