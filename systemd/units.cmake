# The service, its user and its directory. In a system prefix they go where pkg-config says that
# systemd looks; anywhere else they stay below the prefix.
set(prefixes /usr /usr/local /)
foreach(what unit:systemdsystemunitdir:systemd/system sysusers:sysusersdir:sysusers.d
        tmpfiles:tmpfilesdir:tmpfiles.d)
    string(REPLACE ":" ";" what ${what})
    list(GET what 0 name)
    list(GET what 1 variable)
    list(GET what 2 folder)
    set(place "")
    if(CMAKE_INSTALL_PREFIX IN_LIST prefixes)
        pkg_get_variable(place systemd ${variable})
    endif()
    if(NOT place)
        set(place lib/${folder})
    endif()
    set(GIESON_${name}_DIR ${place} CACHE STRING "Where systemd's ${name} files go")
endforeach()

set(GSN_BINDIR ${CMAKE_INSTALL_FULL_BINDIR})
configure_file(gieson.service.in gieson.service @ONLY)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/gieson.service DESTINATION ${GIESON_unit_DIR})
install(FILES gieson.sysusers DESTINATION ${GIESON_sysusers_DIR} RENAME gieson.conf)
install(FILES gieson.tmpfiles DESTINATION ${GIESON_tmpfiles_DIR} RENAME gieson.conf)

if(BUILD_TESTING)
    # The same unit on the programs just built, so that verify finds them.
    set(GSN_BINDIR ${CMAKE_RUNTIME_OUTPUT_DIRECTORY})
    configure_file(gieson.service.in built/gieson.service @ONLY)
    add_test(NAME systemd_units COMMAND ${PROJECT_SOURCE_DIR}/systemd/check_units.sh
        ${CMAKE_CURRENT_BINARY_DIR}/built/gieson.service ${CMAKE_CURRENT_SOURCE_DIR})
    set_tests_properties(systemd_units PROPERTIES SKIP_RETURN_CODE 77)
endif()
