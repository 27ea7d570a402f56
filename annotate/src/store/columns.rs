//! Reads the columns of a row, one after the other, into a value: a number, a text, a tuple, or a struct whose fields
//! are in the order of the columns. A field of another type, such as a list or an answer, is read from a JSON column.

use rusqlite::types::Value;
use serde::de::{DeserializeSeed, Deserializer, Error as _, IntoDeserializer, SeqAccess, Visitor};
use serde::forward_to_deserialize_any;
use serde_json::{Error, Result};

/// Methods of a [`Deserializer`] for types that are read from a column of numbers.
macro_rules! numbers {
    ($($method:ident)+) => { $(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
            self.number(visitor)
        }
    )+ };
}

/// The unread columns of a row.
pub(super) struct Columns<'de>(pub(super) std::slice::Iter<'de, Value>);

impl<'de> Columns<'de> {
    fn take(&mut self) -> Result<&'de Value> {
        let missing = || Error::custom("there is no such column");
        self.0.next().ok_or_else(missing)
    }

    fn text(&mut self) -> Result<&'de str> {
        match self.take()? {
            Value::Text(text) => Ok(text),
            other => Err(Error::custom(format!("it is {other:?}, expected text"))),
        }
    }

    fn number<V: Visitor<'de>>(&mut self, visitor: V) -> Result<V::Value> {
        match self.take()? {
            Value::Integer(value) => visitor.visit_i64(*value),
            Value::Real(value) => visitor.visit_f64(*value),
            other => Err(Error::custom(format!("it is {other:?}, expected a number"))),
        }
    }
}

impl<'de> SeqAccess<'de> for Columns<'de> {
    type Error = Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>> {
        seed.deserialize(self).map(Some)
    }
}

impl<'de> Deserializer<'de> for &mut Columns<'de> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let mut json = serde_json::Deserializer::from_str(self.text()?);
        let value = json.deserialize_any(visitor)?;
        json.end()?;
        Ok(value)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        match self.take()? {
            Value::Integer(flag) => visitor.visit_bool(*flag != 0),
            other => Err(Error::custom(format!("it is {other:?}, expected 0 or 1"))),
        }
    }

    numbers!(deserialize_i64 deserialize_u32 deserialize_u64 deserialize_f64);

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_borrowed_str(self.text()?)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        if let [Value::Null, ..] = self.0.as_slice() {
            self.take()?;
            return visitor.visit_none();
        }
        visitor.visit_some(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value> {
        visitor.visit_enum(self.text()?.into_deserializer())
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value> {
        visitor.visit_seq(self)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value> {
        visitor.visit_seq(self)
    }

    forward_to_deserialize_any! {
        i8 i16 i32 i128 u8 u16 u128 f32 char str bytes byte_buf unit unit_struct newtype_struct seq tuple_struct map
        identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use super::super::db::Row;
    use super::*;
    use crate::wire::{Answer, Lease, TaskKind};

    #[test]
    fn columns_are_read_in_the_order_of_the_fields() {
        let texts = |texts: [&str; 3]| texts.map(|text| Value::Text(text.to_owned()));
        let [kind, style, list] = texts(["pair", r#"{"kind":"style","verdict":"keep"}"#, "[1,2]"]);
        let mut columns: Vec<Value> = (1..=5).map(Value::Integer).collect();
        columns.extend([
            kind,
            Value::Null,
            style,
            Value::Integer(0),
            list,
            Value::Integer(3),
        ]);
        let row = Row(columns);
        let (lease, kind, none, answer, flag, list, real): (
            Lease,
            TaskKind,
            Option<String>,
            Option<Answer>,
            bool,
            Vec<u32>,
            f64,
        ) = row.read().expect("a row");
        assert_eq!((lease.id, lease.expires, kind), (1, 5, TaskKind::Pair));
        assert_eq!((none, flag, list, real), (None, false, vec![1, 2], 3.0));
        assert!(matches!(answer, Some(Answer::Style { .. })));
        let wrong = row
            .read::<(i64, String)>()
            .expect_err("a number")
            .to_string();
        assert!(
            wrong.contains("column 2: it is Integer(2), expected text"),
            "{wrong}"
        );
        assert!(Row(Vec::new()).read::<i64>().is_err());
        let damaged = Row(vec![Value::Text("[1] [2]".to_owned())]);
        assert!(damaged.read::<Vec<u32>>().is_err());
    }
}
