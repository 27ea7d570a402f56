//! Checks of numbers.

use crate::Error;

pub(crate) fn positive(field: &'static str, value: u64) -> Result<(), Error> {
    if value == 0 {
        return Err(Error::config(field, "it must be at least 1"));
    }
    Ok(())
}

pub(crate) fn share(field: &'static str, value: f64) -> Result<(), Error> {
    if !(0.0..1.0).contains(&value) {
        return Err(Error::config(
            field,
            format!("it is {value}, and must lie in [0, 1)"),
        ));
    }
    Ok(())
}
