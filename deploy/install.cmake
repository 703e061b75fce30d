# What is installed, in components: server, client, dev (C++: find_package(horopter_client)), python, demo and console; and the
# Debian packages that deploy/package.sh makes of them.
include(GNUInstallDirs)
set(CMAKE_SKIP_INSTALL_ALL_DEPENDENCY ON)  # tests and benchmarks need not be built for it

# Every option with its default and what it does.
add_custom_command(OUTPUT ${CMAKE_BINARY_DIR}/horopterd.toml
  COMMAND horopterd --print-config > ${CMAKE_BINARY_DIR}/horopterd.toml
  DEPENDS horopterd VERBATIM)
# Manual pages and completion, from the programs' own words.
set(made ${CMAKE_BINARY_DIR}/manual)
file(MAKE_DIRECTORY ${made})
add_custom_command(OUTPUT ${made}/horopter COMMAND horopter completion > ${made}/horopter DEPENDS horopter VERBATIM)
add_custom_command(OUTPUT ${made}/horopter.1.gz
  COMMAND horopter manual > ${made}/horopter.1
  COMMAND gzip -9nf ${made}/horopter.1 DEPENDS horopter VERBATIM)
find_package(Python3 REQUIRED COMPONENTS Interpreter)
add_custom_command(OUTPUT ${made}/horopterd.8.gz
  COMMAND ${Python3_EXECUTABLE} -B ${CMAKE_SOURCE_DIR}/deploy/server_manual.py $<TARGET_FILE:horopterd> > ${made}/horopterd.8
  COMMAND gzip -9nf ${made}/horopterd.8
  DEPENDS horopterd ${CMAKE_SOURCE_DIR}/deploy/server_manual.py VERBATIM)
add_custom_target(sample_config DEPENDS
  ${CMAKE_BINARY_DIR}/horopterd.toml ${made}/horopter ${made}/horopter.1.gz ${made}/horopterd.8.gz)

set(docs ${CMAKE_INSTALL_DATADIR}/doc)
install(TARGETS horopterd RUNTIME COMPONENT server)
install(TARGETS horopter_cad_reader RUNTIME DESTINATION ${CMAKE_INSTALL_LIBEXECDIR}/horopter COMPONENT server)
install(FILES ${CMAKE_BINARY_DIR}/horopterd.toml DESTINATION /etc/horopter COMPONENT server)
# Keys of the server, which the unit hands on to it (LoadCredential).
install(DIRECTORY DESTINATION /etc/horopter/keys DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE COMPONENT server)
install(FILES deploy/horopterd.service DESTINATION /lib/systemd/system COMPONENT server)
install(FILES deploy/horopter-server.logrotate DESTINATION /etc/logrotate.d RENAME horopter-server COMPONENT server)
install(PROGRAMS deploy/credentials.sh DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/deploy COMPONENT server)
install(FILES CHANGELOG.md deploy/grafana/horopter.json deploy/grafana/alerts.yml deploy/grafana/prometheus.yml
  DESTINATION ${docs}/horopter-server COMPONENT server)
# package_page(SOURCE NAME COMPONENT): a page with the links that lead somewhere where packages are installed.
set(pages)
function(package_page source name component)
  set(page ${CMAKE_BINARY_DIR}/pages/${name})
  add_custom_command(OUTPUT ${page} COMMAND ${Python3_EXECUTABLE} -B ${CMAKE_SOURCE_DIR}/deploy/package_page.py ${source} ${page}
    DEPENDS ${CMAKE_SOURCE_DIR}/${source} ${CMAKE_SOURCE_DIR}/deploy/package_page.py VERBATIM)
  install(FILES ${page} DESTINATION ${docs}/horopter-${component} COMPONENT ${component})
  set(pages ${pages} ${page} PARENT_SCOPE)
endfunction()
package_page(README.md README.md server)
package_page(docs/cell.md cell.md server)
package_page(docs/operations.md operations.md server)
package_page(proto/README.md api.md server)
install(FILES ${made}/horopterd.8.gz DESTINATION ${CMAKE_INSTALL_MANDIR}/man8 COMPONENT server)

install(TARGETS horopter RUNTIME COMPONENT client)
install(FILES ${made}/horopter.1.gz DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT client)
install(FILES ${made}/horopter DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions COMPONENT client)

install(TARGETS horopter_client horopter_proto base ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}/horopter COMPONENT dev)
set(headers ${CMAKE_INSTALL_INCLUDEDIR}/horopter_client)
install(FILES client/api.h client/channel.h client/convert.h DESTINATION ${headers}/client COMPONENT dev)
install(FILES server/base/status_macros.h DESTINATION ${headers}/server/base COMPONENT dev)
install(FILES server/vision/geometry/object_model.h server/vision/geometry/rigid3.h server/vision/geometry/surface_print.h
  DESTINATION ${headers}/server/vision/geometry COMPONENT dev)
install(DIRECTORY ${CMAKE_BINARY_DIR}/proto/gen/horopter DESTINATION ${headers} COMPONENT dev
  FILES_MATCHING PATTERN "*.pb.h")
install(DIRECTORY proto/horopter DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/proto COMPONENT dev
  FILES_MATCHING PATTERN "*.proto")
install(DIRECTORY client/example DESTINATION ${docs}/horopter-dev COMPONENT dev)
include(CMakePackageConfigHelpers)
set(config ${CMAKE_INSTALL_LIBDIR}/cmake/horopter_client)
configure_package_config_file(deploy/horopter_clientConfig.cmake.in ${CMAKE_BINARY_DIR}/horopter_clientConfig.cmake
  INSTALL_DESTINATION ${config} PATH_VARS CMAKE_INSTALL_LIBDIR CMAKE_INSTALL_INCLUDEDIR)
write_basic_package_version_file(${CMAKE_BINARY_DIR}/horopter_clientConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/horopter_clientConfig.cmake ${CMAKE_BINARY_DIR}/horopter_clientConfigVersion.cmake
  DESTINATION ${config} COMPONENT dev)

install(DIRECTORY ${CMAKE_BINARY_DIR}/client/python/horopter DESTINATION lib/python3/dist-packages COMPONENT python
  PATTERN "__pycache__" EXCLUDE)
install(DIRECTORY client/python/examples DESTINATION ${docs}/python3-horopter COMPONENT python PATTERN "__pycache__" EXCLUDE)

# The demonstration with its sample parts, laid out as in the source tree; /usr/bin/horopter-demo is a link to it.
install(PROGRAMS deploy/demo.sh DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/deploy COMPONENT demo)
install(FILES deploy/demo_verdict.py DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/deploy COMPONENT demo)
install(DIRECTORY tests/data/parts DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/tests/data COMPONENT demo)
install(FILES tests/data/README.md DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/tests/data COMPONENT demo)
install(CODE "file(MAKE_DIRECTORY \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/bin\")
  file(CREATE_LINK ../share/horopter/deploy/demo.sh \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/bin/horopter-demo\" SYMBOLIC)" COMPONENT demo)

# The operator's page, where Boost was there to build its program; without node or npm the program says itself that the page is missing.
if(TARGET horopter_console)
  add_custom_command(OUTPUT ${CMAKE_BINARY_DIR}/horopter-console.toml
    COMMAND horopter_console --print-config > ${CMAKE_BINARY_DIR}/horopter-console.toml
    DEPENDS horopter_console VERBATIM)
  add_custom_target(console_config DEPENDS ${CMAKE_BINARY_DIR}/horopter-console.toml)
  add_dependencies(sample_config console_config horopter_page)
  install(TARGETS horopter_console RUNTIME COMPONENT console)
  install(FILES ${CMAKE_BINARY_DIR}/horopter-console.toml DESTINATION /etc/horopter COMPONENT console)
  install(DIRECTORY DESTINATION /etc/horopter/keys DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE COMPONENT console)
  install(FILES deploy/horopter-console.service DESTINATION /lib/systemd/system COMPONENT console)
  install(DIRECTORY ${CMAKE_BINARY_DIR}/console/page/ DESTINATION ${CMAKE_INSTALL_DATADIR}/horopter/console COMPONENT console)
  package_page(docs/console.md console.md console)
endif()

# Packages. Terms and changelog of each, as Debian wants them; the dates are of the sources (SOURCE_DATE_EPOCH, package.sh).
set(changelog ${CMAKE_BINARY_DIR}/debian/changelog.gz)
add_custom_command(OUTPUT ${changelog}
  COMMAND ${Python3_EXECUTABLE} -B ${CMAKE_SOURCE_DIR}/deploy/debian_changelog.py ${CMAKE_SOURCE_DIR}/CHANGELOG.md
    ${HOROPTER_VERSION} ${HOROPTER_DEBIAN_VERSION} "${HOROPTER_MAINTAINER}" ${changelog}
  DEPENDS ${CMAKE_SOURCE_DIR}/CHANGELOG.md ${CMAKE_SOURCE_DIR}/deploy/debian_changelog.py VERBATIM)
add_custom_target(package_papers DEPENDS ${changelog} ${pages})
set(packages "server=horopter-server;client=horopter-client;dev=horopter-dev;python=python3-horopter;demo=horopter-demo")
if(TARGET horopter_console)
  list(APPEND packages console=horopter-console)
endif()
foreach(package ${packages})
  string(REGEX MATCH "(.*)=(.*)" _ ${package})
  install(FILES deploy/debian/copyright NOTICE ${changelog} DESTINATION ${docs}/${CMAKE_MATCH_2} COMPONENT ${CMAKE_MATCH_1})
  string(TOUPPER ${CMAKE_MATCH_1} component)
  set(CPACK_DEBIAN_${component}_PACKAGE_NAME ${CMAKE_MATCH_2})
endforeach()

set(CPACK_PACKAGE_NAME horopter)
set(CPACK_PACKAGE_VERSION ${HOROPTER_DEBIAN_VERSION})
set(CPACK_PACKAGE_CONTACT "${HOROPTER_MAINTAINER}")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_SET_DESTDIR OFF)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL server client dev python demo)
if(TARGET horopter_console)
  list(APPEND CPACK_COMPONENTS_ALL console)
endif()
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_ENABLE_COMPONENT_DEPENDS OFF)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
  OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(what "Horopter recognises rigid, man-made parts of which it has CAD files in a few
photographs of a static scene, taken by cameras that nobody calibrated, and
answers with their poses and with grasps.")
set(CPACK_DEBIAN_SERVER_DESCRIPTION "recognises known parts in images of uncalibrated cameras - server
${what}
.
This package holds the server (gRPC) with its systemd unit.")
set(CPACK_DEBIAN_SERVER_PACKAGE_SECTION science)
set(CPACK_DEBIAN_SERVER_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_SERVER_PACKAGE_RECOMMENDS "openssl, logrotate")
file(WRITE ${CMAKE_BINARY_DIR}/debian/conffiles "/etc/horopter/horopterd.toml\n/etc/logrotate.d/horopter-server\n")
set(CPACK_DEBIAN_SERVER_PACKAGE_CONTROL_EXTRA "${CMAKE_BINARY_DIR}/debian/conffiles;${CMAKE_SOURCE_DIR}/deploy/debian/postinst;\
${CMAKE_SOURCE_DIR}/deploy/debian/prerm;${CMAKE_SOURCE_DIR}/deploy/debian/postrm")
set(CPACK_DEBIAN_SERVER_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_CONSOLE_DESCRIPTION "recognises known parts in images of uncalibrated cameras - page
${what}
.
This package holds horopter-console, which serves the operator's page to
browsers and is a client of a server, with its systemd unit.")
set(CPACK_DEBIAN_CONSOLE_PACKAGE_SECTION science)
set(CPACK_DEBIAN_CONSOLE_PACKAGE_SHLIBDEPS ON)
file(WRITE ${CMAKE_BINARY_DIR}/debian/console/conffiles "/etc/horopter/horopter-console.toml\n")
set(CPACK_DEBIAN_CONSOLE_PACKAGE_CONTROL_EXTRA "${CMAKE_BINARY_DIR}/debian/console/conffiles;\
${CMAKE_SOURCE_DIR}/deploy/debian/console/postinst;${CMAKE_SOURCE_DIR}/deploy/debian/console/prerm;\
${CMAKE_SOURCE_DIR}/deploy/debian/console/postrm")
set(CPACK_DEBIAN_CONSOLE_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_CLIENT_DESCRIPTION "recognises known parts in images of uncalibrated cameras - program
${what}
.
This package holds the program horopter: it enrols CAD files, sends images to
a server and draws the answers.")
set(CPACK_DEBIAN_CLIENT_PACKAGE_SECTION science)
set(CPACK_DEBIAN_CLIENT_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_DEV_DESCRIPTION "recognises known parts in images of uncalibrated cameras - C++ client
${what}
.
This package holds the C++ client library, for find_package(horopter_client),
and the definitions of the wire.")
set(CPACK_DEBIAN_DEV_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS "libgrpc++-dev, libprotobuf-dev, libabsl-dev, libeigen3-dev")
set(CPACK_DEBIAN_PYTHON_DESCRIPTION "recognises known parts in images of uncalibrated cameras - Python client
${what}
.
This package holds the Python client.")
set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
set(CPACK_DEBIAN_PYTHON_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "python3:any, python3-grpcio, python3-protobuf, python3-numpy")
set(CPACK_DEBIAN_DEMO_DESCRIPTION "recognises known parts in images of uncalibrated cameras - demonstration
${what}
.
This package holds horopter-demo, which shows the whole path on sample data:
20 parts and four scenes.")
set(CPACK_DEBIAN_DEMO_PACKAGE_SECTION science)
set(CPACK_DEBIAN_DEMO_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_DEMO_PACKAGE_DEPENDS
  "horopter-server (>= ${HOROPTER_DEBIAN_VERSION}), horopter-client (>= ${HOROPTER_DEBIAN_VERSION}), openssl, python3:any")
include(CPack)
