# Installs the build tree into a fresh folder, builds and runs the consumer against that folder alone, configures it with
# the source tree as a subproject, and uninstalls.
# Given: SOURCE_TREE, BUILD_TREE, WORK (scratch folder), GENERATOR, CXX, BUILD_TYPE.
function(run)
  execute_process(COMMAND ${ARGV} COMMAND_ECHO STDOUT COMMAND_ERROR_IS_FATAL ANY)
endfunction()

set(configure ${CMAKE_COMMAND} -S ${SOURCE_TREE}/tests/consumer -G ${GENERATOR}
              -DCMAKE_CXX_COMPILER=${CXX} -DCMAKE_BUILD_TYPE=${BUILD_TYPE})
set(prefix ${WORK}/prefix)
file(REMOVE_RECURSE ${WORK})

run(${CMAKE_COMMAND} --install ${BUILD_TREE} --prefix ${prefix})
run(${configure} -B ${WORK}/installed -DCMAKE_PREFIX_PATH=${prefix})
run(${CMAKE_COMMAND} --build ${WORK}/installed)
run(${WORK}/installed/consumer ${SOURCE_TREE}/problems/two_balls.yaml)
run(${WORK}/installed/own_contact ${SOURCE_TREE}/problems/two_balls.yaml)
run(${WORK}/installed/values)
# What pages show that their programs print, but for a loss that is rounding.
foreach(path how-to/library how-to/hybrid-systems-cpp how-to/own-costs tutorials/contact-model-in-cpp tutorials/mechanical-system)
  get_filename_component(page ${path} NAME)
  execute_process(COMMAND ${WORK}/installed/${page} ${SOURCE_TREE}/problems/two_balls.yaml
                  OUTPUT_VARIABLE printed COMMAND_ERROR_IS_FATAL ANY)
  file(READ ${SOURCE_TREE}/docs/${path}.md text)
  string(REGEX REPLACE "^.*\n```\n\n```\n([^`]*)```\n.*$" "\\1" shown "${text}")
  string(REGEX REPLACE "(loss =|->) [0-9.]+e-[23][0-9]" "\\1 0" printed "${printed}")
  string(REGEX REPLACE "(loss =|->) [0-9.]+e-[23][0-9]" "\\1 0" shown "${shown}")
  if(NOT printed STREQUAL shown)
    message(FATAL_ERROR "${page}.md shows\n${shown}where its program prints\n${printed}")
  endif()
endforeach()

# With a contact model of the user's own: its header gets an entry in the registry, whatever the folder is called.
file(COPY ${SOURCE_TREE}/tests/audit/mirror_model.h DESTINATION "${WORK}/my own models")
run(${configure} -B ${WORK}/subproject -DSALTUS_TREE=${SOURCE_TREE}
    "-DSALTUS_EXTRA_MODELS=${WORK}/my own models/mirror_model.h Mirror")
file(GLOB entries ${WORK}/subproject/saltus/src/registry_entry_*.cc)
set(found FALSE)
foreach(entry IN LISTS entries)
  file(READ ${entry} text)
  if(text MATCHES "\"${WORK}/my own models/mirror_model.h\"" AND text MATCHES "MakeContactEntry<Mirror>")
    set(found TRUE)
  endif()
endforeach()
if(NOT found)
  message(FATAL_ERROR "The model in SALTUS_EXTRA_MODELS has no entry in the registry")
endif()

run(${CMAKE_COMMAND} -DMANIFEST=${BUILD_TREE}/install_manifest.txt -P ${SOURCE_TREE}/cmake/uninstall.cmake)
file(GLOB_RECURSE left ${prefix}/*)
if(left)
  message(FATAL_ERROR "Left behind by uninstall: ${left}")
endif()
