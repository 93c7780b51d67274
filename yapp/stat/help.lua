-- SPDX-License-Identifier: GPL-2.0-or-later
-- What Tools > YAPP > Help says; data only.

return [[
YAPP, the packet protocol of Taurus motor controllers, on CAN, CAN FD, UART, TCP and UDP.

To see                                            display filter
every message with a fault                        taurus.fault.active
where a fault begins, where one ends              taurus.fault.raised || taurus.fault.cleared
all frames of the messages with a fault           yapp.message.fault
a gap; a controller that started anew             yapp.late || taurus.reboot
bad CRCs                                          yapp.crc.status == 0
messages that are not whole                       yapp.fragment.incomplete || yapp.fragment.orphan || yapp.unfinished
sensors that are not connected or out of range    taurus.value.special
one controller                                    yapp.source == "left_fore", or yapp.id == 0x210

Tools > YAPP
Summary               of each controller: rate, gaps, losses, minimum, mean and maximum of its values
Faults                when each fault rose and fell
Events                these, reboots, silences, bad CRCs and losses, in the order of time
Check                 whether rules hold: fault=0,crc=0,incomplete=0,motor.rate=9,motor.dc_voltage=40..55
Export tables         a CSV for each message, in a new folder
Open the flight page  all of a flight on one time axis, in the browser; by yapp-tables, where it is installed

In a window, Show frames makes a display filter of the frames that stand in it: a click on one in the packet list leads
to it.  On the command line the same is tshark -q -r flight.pcapng -z yapp,faults

Other IDs than the default, several controllers, names for them: Edit > Preferences > Protocols > YAPP.
Columns, colours, filter buttons and graphs: the profile YAPP, at the right of the status bar.
README.md and the folder docs of this plugin's files have more.
]]
