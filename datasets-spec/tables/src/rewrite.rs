//! Rewrites the SQL of users for polars: refuses all statements but `SELECT`, and translates `LIKE ... ESCAPE`, tests
//! of lists, `len`, and table names with the name of a dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use arrow_schema::DataType;
use datasets_spec::record::MotionRow;
use datasets_spec::table::{Column, Row as _};
use polars::prelude::PolarsError;
use sqlparser::ast::{
    BinaryOperator, CastKind, DataType as SqlType, Expr, Function, FunctionArg, FunctionArgExpr,
    FunctionArguments, GroupByExpr, Ident, ObjectName, OrderBy, OrderByExpr, OrderByKind,
    OrderByOptions, Query, Select, SelectItem, SetExpr, Statement, TableFactor, Value,
    ValueWithSpan, Visit, VisitMut, Visitor, VisitorMut,
};
use sqlparser::dialect::GenericDialect;
use sqlparser::parser::{Parser, ParserOptions};
use sqlparser::tokenizer::{Token, Tokenizer};

use crate::derived::Derived;

/// Maximum number of operators in a query. Each can nest the expression before it; deep nesting exhausts the stack.
const MOST_OPERATORS: usize = 1_000;

/// Columns that are lists of structs, each with the derived column of its texts.
const OF_STRUCTS: [(&str, Derived); 2] = [
    ("captions", Derived::Texts),
    ("part_captions", Derived::PartTexts),
];

/// The names that a query may use.
#[derive(Clone, Debug, Default)]
pub(crate) struct Names {
    /// Names of datasets, if there are several.
    datasets: BTreeSet<String>,
    /// Columns of each table; for motions, including the derived columns.
    tables: BTreeMap<String, Vec<String>>,
    /// Columns that are lists of texts.
    lists: BTreeSet<String>,
    /// Fields of columns that are structs.
    fields: BTreeMap<String, Vec<String>>,
}

impl Names {
    /// Adds a table. Returns its full name, with the name of its dataset before it if there are several.
    pub(crate) fn add(&mut self, dataset: Option<&str>, table: &str, columns: &[Column]) -> String {
        let full = match dataset {
            Some(dataset) => format!("{dataset}.{table}"),
            None => table.to_owned(),
        };
        self.datasets.extend(dataset.map(str::to_owned));
        let mut typed: Vec<(&str, DataType)> = columns
            .iter()
            .map(|column| (column.name, column.data_type.clone()))
            .collect();
        if table == MotionRow::TABLE {
            let derived = Derived::ALL.into_iter();
            typed.extend(derived.map(|derived| (derived.name(), derived.data_type())));
        }
        for (name, data_type) in &typed {
            match data_type {
                DataType::List(item) if *item.data_type() == DataType::Utf8 => {
                    self.lists.insert((*name).to_owned());
                }
                DataType::Struct(fields) => {
                    let names = fields.iter().map(|field| field.name().clone());
                    self.fields.insert((*name).to_owned(), names.collect());
                }
                _ => {}
            }
        }
        let names = typed.into_iter().map(|(name, _)| name.to_owned());
        self.tables.insert(full.clone(), names.collect());
        full
    }

    /// The texts of a list column, as an expression; `None` if `expr` is no such column.
    fn list(&self, expr: &Expr) -> Option<Expr> {
        let texts = |ident: &Ident| {
            let of_structs = OF_STRUCTS.iter().find(|(name, _)| *name == ident.value);
            match of_structs {
                Some((_, derived)) => Some(Ident::new(derived.name())),
                None => self.lists.contains(&ident.value).then(|| ident.clone()),
            }
        };
        match expr {
            Expr::Nested(inner) => self.list(inner),
            Expr::Identifier(ident) => Some(Expr::Identifier(texts(ident)?)),
            Expr::CompoundIdentifier(parts) => {
                let (last, before) = parts.split_last()?;
                let mut parts = before.to_vec();
                parts.push(texts(last)?);
                Some(Expr::CompoundIdentifier(parts))
            }
            _ => None,
        }
    }
}

fn parser(text: &str) -> Result<Parser<'static>, String> {
    let tokens = Tokenizer::new(&GenericDialect, text)
        .tokenize()
        .map_err(|error| error.to_string())?;
    let operators = tokens.iter().filter(|token| match token {
        Token::Whitespace(_) | Token::Comma | Token::Period => false,
        Token::Word(word) => matches!(
            word.value.to_ascii_lowercase().as_str(),
            "and" | "or" | "not"
        ),
        Token::Number(..) | Token::SingleQuotedString(_) | Token::LParen | Token::RParen => false,
        _ => true,
    });
    if operators.count() > MOST_OPERATORS {
        return Err(format!(
            "it has more than {MOST_OPERATORS} operators; compare one column with many values by IN (...)"
        ));
    }
    let options = ParserOptions::default().with_trailing_commas(true);
    let parser = Parser::new(&GenericDialect).with_options(options);
    Ok(parser.with_tokens(tokens))
}

/// A query for polars.
pub(crate) struct Rewritten {
    pub(crate) text: String,
    /// The order of its rows.
    pub(crate) order: Order,
    query: Box<Query>,
}

/// The order in which polars returns the rows of a query.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// The order of its table.
    Fixed,
    /// The order that the query asks for. Rows that are equal in it come in any order.
    Partial,
    /// Any order.
    None,
}

impl Rewritten {
    /// The text with more columns to order by.
    pub(crate) fn ordered_by(&self, columns: &[&str]) -> String {
        let mut query = self.query.clone();
        if let Some(OrderBy {
            kind: OrderByKind::Expressions(expressions),
            ..
        }) = &mut query.order_by
        {
            expressions.extend(columns.iter().map(|name| OrderByExpr {
                expr: Expr::Identifier(Ident::with_quote('"', *name)),
                options: OrderByOptions::default(),
                with_fill: None,
            }));
        }
        query.to_string()
    }
}

/// Whether a query reads the rows of one table, which polars returns in the order of the table.
fn is_plain(query: &Query) -> bool {
    let SetExpr::Select(select) = &*query.body else {
        return false;
    };
    let Select {
        distinct,
        from,
        group_by,
        ..
    } = &**select;
    let is_one_table = match from.as_slice() {
        [] => true,
        [one] => one.joins.is_empty() && matches!(one.relation, TableFactor::Table { .. }),
        _ => false,
    };
    let is_grouped = !matches!(group_by, GroupByExpr::Expressions(by, _) if by.is_empty());
    query.with.is_none() && distinct.is_none() && is_one_table && !is_grouped
}

pub(crate) fn rewrite_query(text: &str, names: &Names) -> Result<Rewritten, String> {
    let mut parser = parser(text)?;
    let mut statements = parser
        .parse_statements()
        .map_err(|error| error.to_string())?;
    // The parser takes the keyword END for the end of a block of statements, and does not read on.
    let next = parser.peek_token().token;
    if next != Token::EOF {
        return Err(format!(
            "the query ends where the keyword {next} stands; a column of this name stands in double quotes: \"{next}\""
        ));
    }
    let [Statement::Query(query)] = statements.as_mut_slice() else {
        return Err("it is not one SELECT, the only statement there is".to_owned());
    };
    visited(VisitMut::visit(query, &mut Rewriting { names }))?;
    let order = match (query.order_by.is_some(), is_plain(query)) {
        (true, _) => Order::Partial,
        (false, true) => Order::Fixed,
        (false, false) => Order::None,
    };
    Ok(Rewritten {
        order,
        query: query.clone(),
        text: query.to_string(),
    })
}

pub(crate) fn rewrite_condition(text: &str, names: &Names) -> Result<String, String> {
    let mut expr = condition(text)?;
    visited(VisitMut::visit(&mut expr, &mut Rewriting { names }))?;
    Ok(format!("({expr})"))
}

fn condition(text: &str) -> Result<Expr, String> {
    let mut parser = parser(text)?;
    let expr = parser.parse_expr().map_err(|error| error.to_string())?;
    match parser.peek_token().token {
        Token::EOF => Ok(expr),
        token => Err(format!("a condition ends where {token} stands")),
    }
}

fn visited(flow: ControlFlow<String>) -> Result<(), String> {
    match flow {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(problem) => Err(problem),
    }
}

struct Rewriting<'a> {
    names: &'a Names,
}

impl VisitorMut for Rewriting<'_> {
    type Break = String;

    /// Refuses a part of rows that come in no fixed order: the same query would have other answers.
    fn pre_visit_query(&mut self, query: &mut Query) -> ControlFlow<String> {
        let is_part = query.limit_clause.is_some() || query.fetch.is_some();
        if is_part && query.order_by.is_none() && !is_plain(query) {
            return ControlFlow::Break(
                "LIMIT takes any rows where rows are grouped or joined; add an ORDER BY that tells all of them apart"
                    .to_owned(),
            );
        }
        ControlFlow::Continue(())
    }

    /// Names results of functions by their text: `min(seconds)` and `max(seconds)` would otherwise have the same name.
    fn pre_visit_select(&mut self, select: &mut Select) -> ControlFlow<String> {
        for item in &mut select.projection {
            if let SelectItem::UnnamedExpr(expr @ Expr::Function(_)) = item {
                *item = SelectItem::ExprWithAlias {
                    alias: Ident::with_quote('"', expr.to_string()),
                    expr: expr.clone(),
                };
            }
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_table_factor(&mut self, factor: &mut TableFactor) -> ControlFlow<String> {
        match factor {
            TableFactor::Table { args: None, .. }
            | TableFactor::Derived { .. }
            | TableFactor::NestedJoin { .. }
            | TableFactor::UNNEST { .. } => ControlFlow::Continue(()),
            _ => ControlFlow::Break(format!(
                "{factor} is no table; a query reads the tables of its datasets alone: {}",
                listed(self.names.tables.keys())
            )),
        }
    }

    /// `NAME.TABLE` is registered as one name.
    fn pre_visit_relation(&mut self, relation: &mut ObjectName) -> ControlFlow<String> {
        let parts: Vec<Ident> = relation
            .0
            .iter()
            .filter_map(|part| part.as_ident().cloned())
            .collect();
        if let Some(joined) = self.joined(&parts) {
            *relation = ObjectName::from(joined);
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_expr(&mut self, expr: &mut Expr) -> ControlFlow<String> {
        match expr {
            Expr::CompoundIdentifier(parts) => {
                if let Some(joined) = self.joined(parts) {
                    *parts = joined;
                }
            }
            Expr::Function(function) => {
                if takes_texts(function)
                    && let FunctionArguments::List(list) = &mut function.args
                {
                    for arg in &mut list.args {
                        if let FunctionArg::Unnamed(FunctionArgExpr::Expr(arg)) = arg
                            && let Some(texts) = self.names.list(arg)
                        {
                            *arg = texts;
                        }
                    }
                }
            }
            _ => {}
        }
        ControlFlow::Continue(())
    }

    /// Adds a decimal point to numbers that are no 64-bit integers, such as `1e1`: without it, polars fails on them.
    fn pre_visit_value(&mut self, value: &mut ValueWithSpan) -> ControlFlow<String> {
        if let Value::Number(number, _) = &mut value.value
            && !number.contains('.')
            && number.parse::<i64>().is_err()
        {
            let end = number.find(['e', 'E']).unwrap_or(number.len());
            number.insert_str(end, ".0");
        }
        ControlFlow::Continue(())
    }

    fn post_visit_expr(&mut self, expr: &mut Expr) -> ControlFlow<String> {
        let list_of = |expr: &Expr| self.names.list(expr);
        let made = match expr {
            Expr::Like {
                negated,
                any: false,
                expr,
                pattern,
                escape_char,
            } => self.like(expr, pattern, escape_char.as_ref(), *negated, false),
            Expr::ILike {
                negated,
                any: false,
                expr,
                pattern,
                escape_char,
            } => self.like(expr, pattern, escape_char.as_ref(), *negated, true),
            Expr::BinaryOp { left, op, right } => {
                let negated = match op {
                    BinaryOperator::Eq => Some(false),
                    BinaryOperator::NotEq => Some(true),
                    _ => None,
                };
                let compared = list_of(left).zip(negated);
                Ok(compared
                    .map(|(list, negated)| one_of(&list, negated, std::slice::from_ref(&**right))))
            }
            Expr::InList {
                expr,
                list: values,
                negated,
            } => Ok(list_of(expr).map(|list| one_of(&list, *negated, values))),
            Expr::IsNull(inner) => {
                Ok(list_of(inner).map(|list| format!("array_length({list}) = 0")))
            }
            Expr::IsNotNull(inner) => {
                Ok(list_of(inner).map(|list| format!("array_length({list}) > 0")))
            }
            Expr::Function(function) => Ok(self.length(function)),
            Expr::Cast {
                kind: CastKind::Cast | CastKind::DoubleColon,
                expr,
                data_type: SqlType::Date,
                ..
            } => Ok(date(expr)),
            Expr::TypedString(typed) if typed.data_type == SqlType::Date => {
                Ok(Some(format!("DATE({})", typed.value)))
            }
            _ => Ok(None),
        };
        match made.and_then(|made| made.map(|made| parsed(&made)).transpose()) {
            Ok(Some(made)) => *expr = Expr::Nested(Box::new(made)),
            Ok(None) => {}
            Err(problem) => return ControlFlow::Break(problem),
        }
        ControlFlow::Continue(())
    }
}

impl Rewriting<'_> {
    /// Joins the names of a dataset and its table to one identifier.
    fn joined(&self, parts: &[Ident]) -> Option<Vec<Ident>> {
        let [dataset, table, rest @ ..] = parts else {
            return None;
        };
        let full = format!("{}.{}", dataset.value, table.value);
        let is_table =
            self.names.datasets.contains(&dataset.value) && self.names.tables.contains_key(&full);
        is_table.then(|| {
            let mut joined = vec![Ident::with_quote('"', full)];
            joined.extend(rest.iter().cloned());
            joined
        })
    }

    /// Rewrites a `LIKE` that polars lacks: of a list, or with an escape character.
    fn like(
        &self,
        subject: &Expr,
        pattern: &Expr,
        escape: Option<&ValueWithSpan>,
        negated: bool,
        any_case: bool,
    ) -> Result<Option<String>, String> {
        let list = self.names.list(subject);
        if list.is_none() && escape.is_none() {
            return Ok(None);
        }
        let Some(pattern) = text_of(pattern) else {
            return Err(format!("{pattern} is no text in quotes, as a pattern is"));
        };
        let escape = match escape {
            None => None,
            Some(escape) => {
                let text = escape.value.clone().into_string().unwrap_or_default();
                let mut chars = text.chars();
                match (chars.next(), chars.next()) {
                    (Some(escape), None) => Some(escape),
                    _ => return Err(format!("ESCAPE takes one character, not {escape}")),
                }
            }
        };
        let case = if any_case { "i" } else { "" };
        let any = match &list {
            Some(_) => format!("[^{PARTING}]"),
            None => ".".to_owned(),
        };
        let regex = regex_of(pattern, escape, &any)?;
        let not = if negated { "NOT " } else { "" };
        Ok(Some(match list {
            // The texts are joined by a character that none of them contains. Without texts the test is null.
            Some(list) => format!(
                "{not}regexp_like(NULLIF(array_to_string({list}, '{PARTING}'), ''), {})",
                quoted(&format!("(?s{case})(?:^|{PARTING}){regex}(?:{PARTING}|$)"))
            ),
            None => format!(
                "{not}regexp_like({subject}, {})",
                quoted(&format!("(?s{case})^{regex}$"))
            ),
        }))
    }

    /// Rewrites `len` of a list or of a text.
    fn length(&self, function: &Function) -> Option<String> {
        if !function.name.to_string().eq_ignore_ascii_case("len") {
            return None;
        }
        let FunctionArguments::List(list) = &function.args else {
            return None;
        };
        let [FunctionArg::Unnamed(FunctionArgExpr::Expr(of))] = list.args.as_slice() else {
            return None;
        };
        Some(match self.names.list(of) {
            Some(list) => format!("array_length({list})"),
            None => format!("char_length({of})"),
        })
    }
}

/// Turns a cast of a text to a date into the function `DATE`: polars warns that such casts are deprecated.
fn date(text: &Expr) -> Option<String> {
    let is_text = match text {
        Expr::Identifier(_) | Expr::CompoundIdentifier(_) => true,
        text => text_of(text).is_some(),
    };
    is_text.then(|| format!("DATE({text})"))
}

fn takes_texts(function: &Function) -> bool {
    let name = function.name.to_string().to_ascii_lowercase();
    matches!(
        name.as_str(),
        "array_contains" | "array_to_string" | "array_unique" | "unnest"
    )
}

/// A test whether a list contains one of some values, or none of them if `negated`; null for lists without texts.
fn one_of(list: &Expr, negated: bool, values: &[Expr]) -> String {
    let tests = values
        .iter()
        .map(|value| format!("array_contains({list}, {value})"));
    let tests: Vec<String> = tests.collect();
    let not = if negated { "NOT " } else { "" };
    format!(
        "{not}CASE WHEN array_length({list}) > 0 THEN ({}) END",
        tests.join(" OR ")
    )
}

fn parsed(text: &str) -> Result<Expr, String> {
    let parser = Parser::new(&GenericDialect).try_with_sql(text);
    let expr = parser.and_then(|mut parser| parser.parse_expr());
    expr.map_err(|error| error.to_string())
}

fn text_of(expr: &Expr) -> Option<&str> {
    match expr {
        Expr::Value(ValueWithSpan {
            value: Value::SingleQuotedString(text),
            ..
        }) => Some(text),
        _ => None,
    }
}

fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}

/// Separates the texts of a list in a test of `LIKE`.
const PARTING: char = '\u{1e}';

/// A pattern of `LIKE` as a regular expression, in which `any` stands for any character.
fn regex_of(pattern: &str, escape: Option<char>, any: &str) -> Result<String, String> {
    let mut regex = String::new();
    let mut chars = pattern.chars();
    while let Some(next) = chars.next() {
        match next {
            _ if Some(next) == escape => {
                let Some(literal) = chars.next() else {
                    return Err(format!(
                        "pattern '{pattern}' ends with its escape character"
                    ));
                };
                regex += &regex::escape(&literal.to_string());
            }
            '%' => regex += &format!("{any}*"),
            '_' => regex += any,
            literal => regex += &regex::escape(&literal.to_string()),
        }
    }
    Ok(regex)
}

/// Checks that the columns of a condition exist. Columns inside subqueries are checked by polars.
pub(crate) fn check_columns(text: &str, names: &Names) -> Result<(), String> {
    struct Checking<'a> {
        names: &'a Names,
        depth: usize,
    }

    impl Visitor for Checking<'_> {
        type Break = String;

        fn pre_visit_query(&mut self, _: &Query) -> ControlFlow<String> {
            self.depth += 1;
            ControlFlow::Continue(())
        }

        fn post_visit_query(&mut self, _: &Query) -> ControlFlow<String> {
            self.depth -= 1;
            ControlFlow::Continue(())
        }

        fn pre_visit_expr(&mut self, expr: &Expr) -> ControlFlow<String> {
            if self.depth > 0 {
                return ControlFlow::Continue(());
            }
            let table = MotionRow::TABLE;
            let columns = self.names.tables.get(table);
            let columns = columns.map(Vec::as_slice).unwrap_or_default();
            let parts: &[Ident] = match expr {
                Expr::Identifier(ident) => std::slice::from_ref(ident),
                Expr::CompoundIdentifier(parts) => parts,
                _ => return ControlFlow::Continue(()),
            };
            let parts = match parts {
                [first, rest @ ..] if first.value == table && !rest.is_empty() => rest,
                parts => parts,
            };
            let Some(column) = parts.first() else {
                return ControlFlow::Continue(());
            };
            if !columns.contains(&column.value) {
                return ControlFlow::Break(unknown("column", &column.value, columns));
            }
            let fields = self.names.fields.get(&column.value);
            match (parts.get(1), fields) {
                (Some(field), Some(fields)) if !fields.contains(&field.value) => {
                    let what = format!("field of {}", column.value);
                    ControlFlow::Break(unknown(&what, &field.value, fields))
                }
                _ => ControlFlow::Continue(()),
            }
        }
    }

    let checking = &mut Checking { names, depth: 0 };
    visited(Visit::visit(&condition(text)?, checking))
}

/// Error for an unknown name. It suggests the most similar name, and lists all names that exist.
fn unknown(what: &str, name: &str, known: &[String]) -> String {
    /// Minimum similarity of a name that is suggested.
    const NEAR: f64 = 0.75;
    let folded = name.to_lowercase();
    let nearest = known
        .iter()
        .map(|known| (strsim::jaro_winkler(&folded, known), known))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(near, _)| *near >= NEAR);
    let meant = nearest.map_or(String::new(), |(_, known)| format!(" (was {known} meant?)"));
    format!(
        "there is no {what} {name}{meant}; there are {}. Texts stand in single quotes",
        listed(known)
    )
}

fn listed<T: AsRef<str>>(names: impl IntoIterator<Item = T>) -> String {
    let names: Vec<String> = names
        .into_iter()
        .map(|name| name.as_ref().to_owned())
        .collect();
    names.join(", ")
}

fn relations(query: &str) -> BTreeSet<String> {
    struct Named(BTreeSet<String>);

    impl Visitor for Named {
        type Break = ();

        fn pre_visit_relation(&mut self, relation: &ObjectName) -> ControlFlow<()> {
            let parts = relation.0.iter().filter_map(|part| part.as_ident());
            let parts: Vec<&str> = parts.map(|part| part.value.as_str()).collect();
            self.0.insert(parts.join("."));
            ControlFlow::Continue(())
        }
    }

    let mut named = Named(BTreeSet::new());
    if let Ok(statements) = parser(query)
        .and_then(|mut parser| parser.parse_statements().map_err(|error| error.to_string()))
    {
        // The visitor never breaks.
        let _flow = Visit::visit(&statements, &mut named);
    }
    named.0
}

pub(crate) fn problem_of(query: &str, error: &PolarsError, names: &Names) -> String {
    let text = error.to_string();
    let first = text
        .split("\n\nResolved plan")
        .next()
        .unwrap_or(&text)
        .trim();
    let named = relations(query);
    let tables = names
        .tables
        .iter()
        .filter(|(table, _)| named.contains(*table));
    let columns: BTreeSet<&String> = tables.flat_map(|(_, columns)| columns).collect();
    let columns: Vec<String> = columns.into_iter().cloned().collect();
    match error {
        PolarsError::ColumnNotFound(_) if named.is_empty() => format!(
            "it names no table; write FROM and one of {}",
            listed(names.tables.keys())
        ),
        PolarsError::ColumnNotFound(name) => {
            let name = name.to_string();
            let name = name.trim().trim_start_matches("unable to find column ");
            let name = name
                .split(';')
                .next()
                .unwrap_or(name)
                .trim_matches(['"', '\'']);
            unknown("column", name, &columns)
        }
        PolarsError::SQLInterface(_) if first.contains("relation") => {
            format!("{first}; the tables are {}", listed(names.tables.keys()))
        }
        _ => first.to_owned(),
    }
}
