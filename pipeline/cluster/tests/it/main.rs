//! The command `stance-cluster` with schedulers and executors of its own on loopback.
//!
//! `STANCE_BIN` names the command `stance`; `STANCE_TEST_DATA` names a folder of real motion files; `STANCE_KILLS` says
//! how many executors each test of lost executors kills (4 by default).

mod equal;
mod faults;
mod harness;
