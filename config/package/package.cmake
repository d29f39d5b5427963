# SPDX-License-Identifier: Apache-2.0
# Debian packages by CPack: `./dev package`. holdfast: daemon, guard, tools, dashboard, outlets; what the
# author of a robot controller needs: holdfast-client-dev (bridge/client installs it).
include(GNUInstallDirs)
set(files ${CMAKE_CURRENT_LIST_DIR})

install(TARGETS holdfast holdfastd holdfast-guard holdfast-dashboard holdfast-outlets
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT holdfast)
install(DIRECTORY ${PROJECT_BINARY_DIR}/share/holdfast/dashboard
  DESTINATION ${CMAKE_INSTALL_DATADIR}/holdfast COMPONENT holdfast)
# /etc, seen from the prefix /usr: CPack stages only what lies below the staged prefix's parent.
install(FILES config/holdfastd.toml config/guard.toml config/dashboard.toml config/outlets.toml
  config/cyclonedds.xml
  DESTINATION ../etc/holdfast COMPONENT holdfast)
install(FILES ${files}/holdfastd.service ${files}/holdfast-guard.service
  ${files}/holdfast-outlets.service
  DESTINATION lib/systemd/system COMPONENT holdfast)
install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT holdfast)
install(FILES README.md DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT holdfast)
install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/holdfast-client-dev
  COMPONENT client)
install(FILES bridge/idl/holdfast.idl DESTINATION ${CMAKE_INSTALL_DATADIR}/holdfast COMPONENT client)

# Manual pages and completion, from what the programs themselves say.
find_program(HOLDFAST_HELP2MAN help2man REQUIRED)
find_package(Python3 REQUIRED COMPONENTS Interpreter)
set(generated ${PROJECT_BINARY_DIR}/package)
add_custom_target(holdfast_package_files
  COMMAND ${Python3_EXECUTABLE} ${files}/generate.py --bin ${CMAKE_RUNTIME_OUTPUT_DIRECTORY}
    --help2man ${HOLDFAST_HELP2MAN} --version ${PROJECT_VERSION} --out ${generated}
  DEPENDS holdfast holdfastd holdfast-guard holdfast-dashboard holdfast-outlets VERBATIM)
install(DIRECTORY ${generated}/man1 DESTINATION ${CMAKE_INSTALL_MANDIR} COMPONENT holdfast)
install(DIRECTORY ${generated}/completions DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion
  COMPONENT holdfast)

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_VENDOR "Holdfast")
set(CPACK_PACKAGE_CONTACT "Holdfast maintainers <holdfast@localhost>")
set(CPACK_PACKAGE_DIRECTORY ${PROJECT_BINARY_DIR}/packages)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL holdfast client)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_HOLDFAST_PACKAGE_NAME holdfast)
set(CPACK_DEBIAN_HOLDFAST_PACKAGE_DEPENDS adduser)
set(CPACK_DEBIAN_HOLDFAST_PACKAGE_CONTROL_EXTRA ${files}/conffiles ${files}/postinst)
set(CPACK_COMPONENT_HOLDFAST_DESCRIPTION
  "Keeps a microscope-mounted laser robot registered to the patient's ear
 and stops it when it cannot: real-time daemon, independent guard, tools,
 dashboard, ROS 2 and OpenIGTLink outlets. Research software, not a medical device.")
set(CPACK_DEBIAN_CLIENT_PACKAGE_NAME holdfast-client-dev)
set(CPACK_DEBIAN_CLIENT_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_CLIENT_PACKAGE_DEPENDS "cyclonedds-dev (>= 0.10), libssl-dev")
set(CPACK_COMPONENT_CLIENT_DESCRIPTION
  "Holdfast: what a robot controller links
 Header, static library and CMake package of the client that answers
 \"may I act on this pose now\"; the IDL of every topic.")
include(CPack)
