//! Tests of the trainer that need a dataset or the reference's numbers. They are a package of their own so that a change
//! of `pipeline` does not compile the unit tests of `train` again.

mod bert;
mod clip;
mod golden;
mod learning;
mod oracle;
mod precision;
#[path = "../../tests/data/golden.rs"]
mod recorded;
mod shared;
