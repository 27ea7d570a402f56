//! The command `stance-cluster` with schedulers and executors of its own on loopback.
//!
//! `STANCE_BIN` names the command `stance`; `STANCE_TEST_DATA` a folder of real motion files; `STANCE_KILLS` how many
//! executors the test of lost executors kills (4, if it is not set).

mod equal;
mod faults;
mod harness;
