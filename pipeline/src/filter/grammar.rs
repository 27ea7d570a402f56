//! The grammar of filters, a subset of SQL's conditions.

/// A condition on a clip.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Expression {
    All(Vec<Expression>),
    Any(Vec<Expression>),
    Not(Box<Expression>),
    Test {
        column: String,
        /// Place of the column's name in the text, in bytes.
        at: usize,
        test: Test,
    },
}

/// What is asked of a column.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Test {
    /// A column of truth values is true.
    Holds,
    IsNull,
    Compare(Comparison, Value),
    Like(String),
    In(Vec<Value>),
}

/// A comparison of two values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Comparison {
    Equal,
    Unequal,
    Less,
    AtMost,
    Greater,
    AtLeast,
}

/// A value written in a filter.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Text(String),
    Number(f64),
}

const KEYWORDS: [&str; 7] = ["and", "or", "not", "in", "is", "like", "null"];
/// Longer ones first.
const SYMBOLS: [&str; 11] = ["!=", "<>", "<=", ">=", "==", "=", "<", ">", "(", ")", ","];

/// A mistake: its byte, and what was expected there.
type Mistake = (usize, String);

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Symbol(&'static str),
    /// Keyword, in lower case.
    Word(&'static str),
    Name(String),
    Value(Value),
}

/// Parses a condition.
///
/// # Errors
/// The byte at which it is no condition, and what was expected there.
pub(super) fn parse(text: &str) -> Result<Expression, Mistake> {
    let mut parser = Parser {
        tokens: tokens(text)?,
        next: 0,
        end: text.len(),
    };
    let expression = parser.chain("or")?;
    if parser.next < parser.tokens.len() {
        return parser.expected("`and`, `or` or the end");
    }
    Ok(expression)
}

fn tokens(text: &str) -> Result<Vec<(usize, Token)>, Mistake> {
    let mut tokens = Vec::new();
    let mut at = 0;
    while let Some(first) = text[at..].chars().next() {
        let rest = &text[at..];
        let (length, token) = if first.is_whitespace() {
            at += first.len_utf8();
            continue;
        } else if let Some(symbol) = SYMBOLS.iter().find(|symbol| rest.starts_with(**symbol)) {
            (symbol.len(), Token::Symbol(symbol))
        } else if first == '\'' || first == '"' {
            let (length, quoted) = quoted(rest, first)
                .ok_or_else(|| (at, "expected a quote that ends the text".to_owned()))?;
            (length, Token::Value(Value::Text(quoted)))
        } else {
            let in_word = |c: char| c.is_alphanumeric() || "_.-+".contains(c);
            let length = rest.find(|c| !in_word(c)).unwrap_or(rest.len());
            let word = &rest[..length];
            let keyword = KEYWORDS
                .iter()
                .find(|known| known.eq_ignore_ascii_case(word));
            let starts_number = first.is_ascii_digit() || "-+.".contains(first);
            let token = match (keyword, word.parse()) {
                (Some(keyword), _) => Token::Word(keyword),
                (None, Ok(number)) if starts_number => Token::Value(Value::Number(number)),
                (None, _) if first.is_alphabetic() || first == '_' => Token::Name(word.to_owned()),
                _ => return Err((at, format!("expected a column or a value, found {first:?}"))),
            };
            (length, token)
        };
        tokens.push((at, token));
        at += length;
    }
    Ok(tokens)
}

/// A text in quotes, and its length with them; a doubled quote stands for one.
fn quoted(rest: &str, quote: char) -> Option<(usize, String)> {
    let mut found = String::new();
    let mut characters = rest.char_indices().skip(1).peekable();
    loop {
        let (at, next) = characters.next()?;
        if next == quote && characters.next_if(|(_, next)| *next == quote).is_none() {
            return Some((at + 1, found));
        }
        found.push(next);
    }
}

struct Parser {
    tokens: Vec<(usize, Token)>,
    next: usize,
    end: usize,
}

impl Parser {
    fn expected<T>(&self, what: &str) -> Result<T, Mistake> {
        let at = self.tokens.get(self.next).map_or(self.end, |(at, _)| *at);
        Err((at, format!("expected {what}")))
    }

    /// Passes over a token, if it is the next one.
    fn skip(&mut self, token: &Token) -> bool {
        let found = self
            .tokens
            .get(self.next)
            .is_some_and(|(_, next)| next == token);
        self.next += usize::from(found);
        found
    }

    fn symbol(&mut self, symbol: &'static str) -> bool {
        self.skip(&Token::Symbol(symbol))
    }

    fn word(&mut self, word: &'static str) -> bool {
        self.skip(&Token::Word(word))
    }

    /// Operands joined by `or`, each of them operands joined by `and`.
    fn chain(&mut self, joint: &'static str) -> Result<Expression, Mistake> {
        let mut operands = Vec::new();
        loop {
            operands.push(match joint {
                "or" => self.chain("and")?,
                _ => self.negation()?,
            });
            if !self.word(joint) {
                break;
            }
        }
        Ok(match (operands.len(), joint) {
            (1, _) => operands.remove(0),
            (_, "or") => Expression::Any(operands),
            _ => Expression::All(operands),
        })
    }

    fn negation(&mut self) -> Result<Expression, Mistake> {
        if self.word("not") {
            return Ok(Expression::Not(Box::new(self.negation()?)));
        }
        if self.symbol("(") {
            let inner = self.chain("or")?;
            return match self.symbol(")") {
                true => Ok(inner),
                false => self.expected("`and`, `or` or `)`"),
            };
        }
        self.condition()
    }

    fn condition(&mut self) -> Result<Expression, Mistake> {
        let Some((at, Token::Name(column))) = self.tokens.get(self.next).cloned() else {
            return self.expected("a column");
        };
        self.next += 1;
        let is = self.word("is");
        let negated = self.word("not");
        let test = if is {
            match self.word("null") {
                true => Test::IsNull,
                false => return self.expected("`null` or `not null`"),
            }
        } else if self.word("like") {
            match self.value() {
                Some(Value::Text(pattern)) => Test::Like(pattern),
                _ => return self.expected("a pattern in quotes, such as '%walk%'"),
            }
        } else if self.word("in") {
            Test::In(self.values()?)
        } else if negated {
            return self.expected("`in` or `like`");
        } else {
            match self.comparison() {
                None => Test::Holds,
                Some(comparison) => match self.value() {
                    Some(value) => Test::Compare(comparison, value),
                    None => return self.expected("a number, or a text in quotes"),
                },
            }
        };
        let test = Expression::Test { column, at, test };
        Ok(match negated {
            true => Expression::Not(Box::new(test)),
            false => test,
        })
    }

    fn comparison(&mut self) -> Option<Comparison> {
        use Comparison::{AtLeast, AtMost, Equal, Greater, Less, Unequal};
        let known = [
            ("=", Equal),
            ("==", Equal),
            ("!=", Unequal),
            ("<>", Unequal),
            ("<", Less),
            ("<=", AtMost),
            (">", Greater),
            (">=", AtLeast),
        ];
        let found = known.into_iter().find(|(symbol, _)| self.symbol(symbol));
        found.map(|(_, comparison)| comparison)
    }

    fn value(&mut self) -> Option<Value> {
        let Some((_, Token::Value(value))) = self.tokens.get(self.next) else {
            return None;
        };
        let value = value.clone();
        self.next += 1;
        Some(value)
    }

    fn values(&mut self) -> Result<Vec<Value>, Mistake> {
        let mut values = Vec::new();
        let mut more = self.symbol("(");
        while more {
            let Some(value) = self.value() else { break };
            values.push(value);
            more = self.symbol(",");
            if !more && self.symbol(")") {
                return Ok(values);
            }
        }
        self.expected("values in parentheses, such as ('a', 'b')")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn test(column: &str, at: usize, test: Test) -> Expression {
        Expression::Test {
            column: column.to_owned(),
            at,
            test,
        }
    }

    #[test]
    fn and_binds_more_tightly_than_or_and_not_more_tightly_than_both() {
        let holds = |name: &str, at| test(name, at, Test::Holds);
        let not = |inner| Expression::Not(Box::new(inner));
        assert_eq!(
            parse("not a OR b and c"),
            Ok(Expression::Any(vec![
                not(holds("a", 4)),
                Expression::All(vec![holds("b", 9), holds("c", 15)]),
            ]))
        );
        assert_eq!(
            parse(" not (a or b)"),
            Ok(not(Expression::Any(vec![holds("a", 6), holds("b", 11)])))
        );
    }

    #[test]
    fn conditions_are_read_with_their_values() {
        let text = |text: &str| Value::Text(text.to_owned());
        let not = |inner| Expression::Not(Box::new(inner));
        for (written, read) in [
            (
                "a='it''s'",
                test("a", 0, Test::Compare(Comparison::Equal, text("it's"))),
            ),
            (
                "a <> \"x\"",
                test("a", 0, Test::Compare(Comparison::Unequal, text("x"))),
            ),
            (
                "a >= -1.5e2",
                test(
                    "a",
                    0,
                    Test::Compare(Comparison::AtLeast, Value::Number(-150.0)),
                ),
            ),
            (
                "a in ('x', 2)",
                test("a", 0, Test::In(vec![text("x"), Value::Number(2.0)])),
            ),
            (
                "a not in (1)",
                not(test("a", 0, Test::In(vec![Value::Number(1.0)]))),
            ),
            (
                "a not like 'x%'",
                not(test("a", 0, Test::Like("x%".to_owned()))),
            ),
            ("a is null", test("a", 0, Test::IsNull)),
            ("a is not null ", not(test("a", 0, Test::IsNull))),
            ("flags.poor-fit", test("flags.poor-fit", 0, Test::Holds)),
        ] {
            assert_eq!(parse(written), Ok(read), "{written}");
        }
    }

    #[test]
    fn errors_say_where_and_what_was_expected() {
        for (written, at, said) in [
            ("", 0, "a column"),
            ("a = ", 4, "a number, or a text in quotes"),
            ("a = 'x", 4, "a quote that ends the text"),
            ("a = 1 b = 2", 6, "`and`, `or` or the end"),
            ("a = 1 and", 9, "a column"),
            ("a in x", 5, "values in parentheses"),
            ("a in (1 2)", 8, "values in parentheses"),
            ("(a", 2, "`and`, `or` or `)`"),
            ("a = 1e", 4, "a column or a value"),
            ("a ; b", 2, "a column or a value"),
            ("a is 3", 5, "`null` or `not null`"),
        ] {
            let (found, problem) = parse(written).expect_err(written);
            assert!(problem.contains(said), "{written}: {problem}");
            assert_eq!(found, at, "{written}: {problem}");
        }
    }
}
