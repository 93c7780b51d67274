-- SPDX-License-Identifier: GPL-2.0-or-later
-- The catalogue of Taurus messages: data only.
--
-- How to add a message: append an entry to the list at the end of this file.  Filters, tree,
-- preference, Info column and CSV follow.  The tests have a list of their own, see CONTRIBUTING.md.
--
--   {
--     name = "battery", title = "Battery", id = 0x340, size = 3, info = "{level:%.0f unit}",
--     { "level", "uint16", "Level", scale = 0.1, unit = "%" },
--     { "mode", "uint8", "Mode", values = { [0] = "Off", [1] = "Charging" } },
--   },
--
-- An entry has options, and a row { filter name, type, title, options } for each field in the order
-- of the payload.  docs/catalogue.md names all options and types.
--
-- Messages of your own belong in a file of the same form, yapp_messages.lua in Wireshark's personal
-- configuration folder, which a new version of the plugin leaves alone: see docs/messages.md.
--
-- Sections in quotes are those of the vendor's document, 600-0055-000 Rev A.

-- "Taurus Command", "Taurus Motor Data": Motor Mode
local MOTOR_MODE = { [0] = "Torque Mode", [1] = "Speed Mode" }

-- "Taurus Motor Data": Status Flags.  Some mask digits of the document are damaged; the order of
-- the table and the example settle them, see docs/document.md.
local STATUS = {
  { "foc_align", 0x2, "FOC in align" },
  { "start_in_motion_no_bemf", 0x1000, "Start in Motion, Back EMF signal not detected" },
  { "start_in_motion_bemf", 0x2000, "Start in Motion, Back EMF signal detected" },
  { "waiting_for_stop", 0x4000, "Waiting for motor to stop" },
  { "braking", 0x8000, "Motor is braking" },
  { "stopped", 0x10000, "Motor is stopped" },
  { "enabled", 0x20000, "Motor is enabled" },
  { "open_loop", 0x40000, "FOC in open loop mode" },
  { "closed_loop_ramp", 0x80000, "FOC in closed loop speed ramp up" },
  { "closed_loop", 0x100000, "FOC in closed loop mode" },
  { "closed_loop_2", 0x200000, "FOC in closed loop mode (second entry)" },
  { "reverse_direction", 0x400000, "Motor in reverse direction mode" },
  { "field_weakening", 0x800000, "Motor in Field Weakening range" },
  { "overmodulation", 0x1000000, "Motor operating in Over-Modulation region" },
  { "hall_position", 0x2000000, "Motor Position taken from Hall Sensor" },
  { "mpos_update", 0x40000000, "Flag MPOS: Update motor position values" },
}

-- "Taurus Motor Data": Fault Flags.  The document has names alone.  So `help`, where to look first,
-- ends with "(our note)", but for what stands in the document.
local FAULT = {
  { "oc_limit_unmeasurable", 0x1, "OC limit higher than measurable current",
    help = "The limit cannot trip. Look at the configured limit (our note)" },
  { "cbc_oc_lpdac", 0x2, "CBC OC LPDAC",
    help = "Hardware cut PWM cycles short. Look at current and load (our note)" },
  { "pwm_saturated", 0x4, "PWM duty cycle is saturated",
    help = "No voltage is left for control. Look at DC Voltage and speed (our note)" },
  { "stack_overflow", 0x8, "Stack overflow or underflow",
    help = "The firmware is not reliable any more. Ask the vendor (our note)" },
  { "open_loop_speed_low", 0x10, "Open loop speed is lower than closed-loop minimum speed",
    help = "It may not reach closed loop. Look at the start's parameters (our note)" },
  { "est_angle_diff", 0x20, "Estimator AngleDiff out of range",
    help = "The rotor's angle is doubtful. Look at load and parameters (our note)" },
  { "foc_time_exceeded", 0x40, "FOC control time has been exceeded",
    help = "Control came late. Look at CPU usage in Health (our note)" },
  { "bus_voltage_limit", 0x80, "Bus Voltage Min/Max limit exceeded",
    help = "Look at DC Voltage: sag, or rise while braking (our note)" },
  { "pi_gain_range", 0x100, "PI controller gain out of range",
    help = "Look at the gains in the configuration (our note)" },
  { "stall_filter_floor", 0x200, "Stall filter value floored at minimum",
    help = "Look at the speed: the motor nearly stalls (our note)" },
  { "est_speed_diff", 0x400, "Estimator SpeedDiff out of range",
    help = "The measured speed is doubtful. Look at load and parameters (our note)" },
  { "atpi_warning", 0x800, "ATPI Warning (check ATPI Status)",
    help = "Check ATPI Status" },
  { "control_freq_ratio", 0x1000, "Control Freq to Estimator > 10:1",
    help = "Look at both frequencies in the configuration (our note)" },
  { "hall_period_invalid", 0x2000, "Hall Timer Period Invalid",
    help = "Look at the Hall sensors, their cable and noise (our note)" },
  { "coast_timeout", 0x4000, "Motor Coast timeout",
    help = "It did not coast to a stop in time. Look at wind and inertia (our note)" },
  { "est_diff_timeout", 0x8000, "EstSpeed/AngleDiff timeout",
    help = "The estimator stays out of range. Look at load and parameters (our note)" },
  { "motor_overcurrent", 0x10000, "Motor overcurrent",
    help = "Look at current and speed before it, load, short circuits (our note)" },
  { "bus_voltage_disabled", 0x20000, "Motor disabled due to bus voltage min/max fault",
    help = "Look at DC Voltage before it: sag, or rise while braking (our note)" },
  { "open_phase", 0x40000, "Motor Open Phase Detection",
    help = "A phase carries no current. Look at connectors and windings (our note)" },
  { "flash_crc", 0x100000, "Flash CRC Test Status Failed",
    help = "Firmware or parameters are damaged. Write them anew (our note)" },
  { "critical_parameter", 0x200000, "Attempted change to critical parameter while running",
    help = "x (our note)" },
  { "afe_init", 0x400000, "AFE not initialized properly",
    help = "The analog front end did not start. Look at the supply (our note)" },
  { "motor_stall", 0x800000, "Motor Stall Detection",
    help = "The rotor did not follow. Look at load, propeller and current (our note)" },
  { "ppm_timeout", 0x1000000, "PPM pulse timeout, no received valid PPM pulse",
    help = "Look at the cable and the sender of the PPM signal (our note)" },
  { "adc_calibration", 0x2000000, "ADC calibration failed",
    help = "Currents cannot be trusted. Restart with the motor at rest (our note)" },
  { "est_inputs_invalid", 0x4000000, "Estimator inputs are invalid",
    help = "Look at measured currents and voltages, and ADC calibration (our note)" },
  { "hall_timeout", 0x10000000, "Hall timer expired without detecting hall transition",
    help = "Look at the Hall sensors, their cable, and a rotor at rest (our note)" },
  { "start_wrong_direction", 0x20000000, "Start in motion, wrong direction detected",
    help = "It turned backwards. Look at wind and the order of phases (our note)" },
  { "hardware_over_temperature", 0x40000000, "Hardware exceeded temperature threshold",
    help = "Look at ESC and FET Temperature, cooling and load (our note)" },
  { "reserved", 0x80000000, "Reserved",
    help = "The document gives it no meaning. Ask the vendor (our note)" },
}

-- "Taurus Motor Data": Motor State
local STATE = {
  { "ready", 0x1, "Ready" },
  { "running", 0x2, "Running" },
  { "stopped", 0x4, "Stopped" },
  { "overmodulated", 0x8, "Overmodulated" },
  { "saturated", 0x10, "Saturated" },
  { "faulted", 0x20, "Faulted", alarm = true,
    help = "Fault Flags has the cause (our note)" },
}

-- "Taurus Health": Taurus Status
local HEALTH = {
  { "regeneration_enabled", 0x1, "Regeneration Enabled" },
  { "reversed", 0x2, "Reversed" },
  { "precharging", 0x4, "Precharging" },
}

return {
  { -- faster than 5 Hz
    name = "command",
    title = "Command",
    section = "Taurus Command",
    id = 0x000,
    size = 7,
    every = 0.2,
    enables = "enabled",
    info = "{enabled}, {key}  {motor_mode}  {rpm:%.1f unit}  {torque_iq:%.2f unit}",
    { "enabled", "uint8", "Enabled", values = { [0] = "Disabled", [1] = "Enabled" } },
    { "key", "uint8", "Key", invalid = "command.key.invalid",
      values = { [0xA5] = "Full Operation", [0x5A] = "No Regeneration Allowed" } },
    { "motor_mode", "uint8", "Motor Mode", values = MOTOR_MODE },
    { "torque_iq", "float16", "Torque IQ", min = -200, max = 200, unit = "A" },
    { "rpm", "float16", "RPM", min = -100000, max = 100000, unit = "RPM" },
  },
  { -- 10 Hz
    name = "motor",
    title = "Motor Data",
    section = "Taurus Motor Data",
    id = 0x210,
    size = 32,
    every = 0.1,
    answers = "command",
    speed = "rpm_measured",
    info = "{rpm_commanded:%.1f}/{rpm_measured:%.1f unit}  " ..
      "{dc_voltage:%.2f unit}  {dc_current:%.2f unit}",
    info_rest = "ESC {esc_temperature:%.0f unit}  {torque_iq_measured:%.2f unit} torque",
    differences = {
      { "torque_iq_error", "torque_iq_measured", "torque_iq_commanded", "Torque IQ Error" },
      { "rpm_error", "rpm_measured", "rpm_commanded", "RPM Error" },
    },
    derived = { { "dc_power", "dc_voltage * dc_current", "DC Power", unit = "W" } },
    { "torque_iq_commanded", "float16", "Torque IQ Commanded", min = -128, max = 128, unit = "A" },
    { "torque_iq_measured", "float16", "Torque IQ Measured", min = -128, max = 128, unit = "A" },
    { "rpm_commanded", "float16", "RPM Commanded", min = -60000, max = 60000, unit = "RPM" },
    { "rpm_measured", "float16", "RPM Measured", min = -60000, max = 60000, unit = "RPM" },
    { "dc_voltage", "float16", "DC Voltage", min = -128, max = 128, unit = "V" },
    { "dc_current", "float16", "DC Current", min = -128, max = 128, unit = "A" },
    { "motor_temperature", "float8", "Motor Temperature", min = -40, max = 210, unit = "°C" },
    { "motor_mode", "uint8", "Motor Mode", values = MOTOR_MODE },
    { "status_flags", "uint32", "Status Flags", flags = STATUS, group = "status" },
    { "fault_flags", "uint32", "Fault Flags", flags = FAULT, group = "fault", alarm = true },
    { "timestamp", "int64_ns", "Timestamp" },
    { "motor_state", "uint8", "Motor State", flags = STATE, group = "state" },
    { "esc_temperature", "float8", "ESC Temperature", min = -40, max = 210, unit = "°C" },
  },
  { -- 2 Hz
    name = "health",
    title = "Health",
    section = "Taurus Health",
    id = 0x200,
    size = 17,
    every = 0.5,
    info = "control {control_thread_cpu:%.0f unit}, Taurus {taurus_thread_cpu:%.0f unit}  " ..
      "CPU {cpu_temperature:%.0f unit}, FET {fet_temperature:%.0f unit}",
    { "timestamp", "int64_ns", "Timestamp" },
    { "control_thread_cpu", "float8", "Control Thread CPU Usage", min = 0, max = 100, unit = "%" },
    { "taurus_thread_cpu", "float8", "Taurus Thread CPU Usage", min = 0, max = 100, unit = "%" },
    { "cpu_temperature", "float8", "CPU Temperature", min = -40, max = 210, unit = "°C" },
    { "capacitor_temperature", "float8", "Capacitor Temperature",
      min = -40, max = 210, unit = "°C" },
    { "fet_temperature", "float8", "FET Temperature", min = -40, max = 210, unit = "°C" },
    { "vin_rms_ripple", "float8", "Vin RMS Ripple", min = 0, max = 12.5, unit = "V" },
    { "vin_pp_ripple", "float8", "Vin Peak to Peak Ripple", min = 0, max = 12.5, unit = "V" },
    { "taurus_status", "uint8", "Taurus Status", flags = HEALTH, group = "status" },
    { "board_revision", "uint8", "Board Revision" },
  },
}
