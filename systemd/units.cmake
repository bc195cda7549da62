# SPDX-License-Identifier: AGPL-3.0-or-later
# The services, their timers, user, directory and configuration. In a system prefix they go where
# pkg-config says that systemd looks; anywhere else they stay below the prefix.
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

# The services share what they shut; systemd has no include, so it is put into each.
foreach(part sandbox alone)
    string(TOUPPER ${part} upper)
    file(READ ${part}.inc GSN_${upper})
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${part}.inc)
endforeach()

set(services gieson gieson-worker gieson-night gieson-scrub gieson-scrub-quick gieson-notify@)
set(timers gieson-night.timer gieson-scrub.timer gieson-scrub-quick.timer)
set(GSN_BINDIR ${CMAKE_INSTALL_FULL_BINDIR})
set(GSN_CONFDIR ${CMAKE_INSTALL_FULL_SYSCONFDIR}/gieson)
foreach(service ${services})
    configure_file(${service}.service.in ${service}.service @ONLY)
    install(FILES ${CMAKE_CURRENT_BINARY_DIR}/${service}.service DESTINATION ${GIESON_unit_DIR})
endforeach()
install(FILES ${timers} DESTINATION ${GIESON_unit_DIR})
install(FILES gieson.sysusers DESTINATION ${GIESON_sysusers_DIR} RENAME gieson.conf)
install(FILES gieson.tmpfiles DESTINATION ${GIESON_tmpfiles_DIR} RENAME gieson.conf)
install(FILES gieson.conf DESTINATION ${CMAKE_INSTALL_FULL_SYSCONFDIR}/gieson)
install(DIRECTORY DESTINATION ${CMAKE_INSTALL_FULL_SYSCONFDIR}/gieson/conf.d)

if(BUILD_TESTING)
    # The same units on the programs just built, so that verify finds them.
    set(GSN_BINDIR ${CMAKE_RUNTIME_OUTPUT_DIRECTORY})
    foreach(service ${services})
        configure_file(${service}.service.in built/${service}.service @ONLY)
    endforeach()
    foreach(timer ${timers})
        configure_file(${timer} built/${timer} COPYONLY)
    endforeach()
    add_test(NAME systemd_units COMMAND ${PROJECT_SOURCE_DIR}/systemd/check_units.sh
        ${CMAKE_CURRENT_BINARY_DIR}/built ${CMAKE_CURRENT_SOURCE_DIR})
    # 77: it says that systemd-analyze is missing.
    set_tests_properties(systemd_units PROPERTIES SKIP_RETURN_CODE 77)
endif()
