# SPDX-License-Identifier: Apache-2.0
# A robot controller outside of Holdfast: installs the client, builds bridge/client/example against
# the installation alone, and runs it beside a publishing daemon: it must move, and then stop.
# cmake -DBUILD=... -DSOURCE=... -DPEER=... -DWORK=... -P client_package_test.cmake
function(must_run what)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE result OUTPUT_VARIABLE out ERROR_VARIABLE out)
  if(NOT result EQUAL 0)
    message(FATAL_ERROR "${what} failed (${result}):\n${out}")
  endif()
endfunction()

file(REMOVE_RECURSE ${WORK})
must_run("install" ${CMAKE_COMMAND} --install ${BUILD} --component client --prefix ${WORK}/prefix)
must_run("configure" ${CMAKE_COMMAND} -S ${SOURCE}/bridge/client/example -B ${WORK}/build
  -DCMAKE_PREFIX_PATH=${WORK}/prefix -DCMAKE_BUILD_TYPE=Release ${TOOLCHAIN})
must_run("build" ${CMAKE_COMMAND} --build ${WORK}/build)

# A domain of its own.
string(RANDOM LENGTH 2 ALPHABET 123456789 domain)
set(ENV{CYCLONEDDS_URI} "file://${SOURCE}/config/cyclonedds-local.xml,<CycloneDDS><Domain><Discovery><Tag>package-${domain}</Tag></Discovery></Domain></CycloneDDS>")
# The peer publishes for 3 s; the robot runs 5 s: it sees the beginning and the end.
execute_process(
  COMMAND timeout 3 ${PEER} publish ${domain}
  COMMAND sh -c "cat >/dev/null & exec '${WORK}/build/robot_controller' ${domain} 5"
  OUTPUT_VARIABLE out ERROR_VARIABLE error RESULTS_VARIABLE results)
list(GET results 1 robot_result)
if(NOT robot_result EQUAL 0)
  message(FATAL_ERROR "the robot failed (${robot_result}): ${error}${out}")
endif()
if(NOT out MATCHES "moving: none")
  message(FATAL_ERROR "the robot never moved:\n${out}")
endif()
if(NOT out MATCHES "stopped: (stop|pose)_silent\ncycles moved")
  message(FATAL_ERROR "the robot did not end stopped by silence:\n${out}")
endif()
message("${out}")
