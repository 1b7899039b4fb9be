//! Tokens and parameter lists of pbrt files.

use crate::{Error, Result};
use std::path::Path;
use std::rc::Rc;

/// Where a token stands.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) file: Rc<Path>,
    pub(super) line: u32,
}

impl Place {
    pub(super) fn invalid(&self, what: impl Into<String>) -> Error {
        Error::invalid(&self.file, self.line, what)
    }

    pub(super) fn unsupported(&self, what: impl Into<String>) -> Error {
        Error::unsupported(&self.file, self.line, what)
    }

    pub(super) fn warning(&self, what: impl std::fmt::Display) -> String {
        format!("{}: {what}", crate::error::place(&self.file, Some(self.line)))
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Token {
    /// A directive, or `true` and `false`.
    Word(String),
    /// In quotes.
    Text(String),
    Number(f64),
    Open,
    Close,
}

/// The tokens of one file.
pub(super) struct Lexer {
    text: Vec<u8>,
    at: usize,
    pub(super) place: Place,
    ahead: Option<Token>,
    /// Messages quote the file: not one that a scene includes, which may be any.
    pub(super) quotes: bool,
}

impl Lexer {
    pub(super) fn new(path: &Path, text: String, quotes: bool) -> Self {
        Self { text: text.into_bytes(), at: 0, place: Place { file: path.into(), line: 1 }, ahead: None, quotes }
    }

    /// What stands there instead of what is wanted.
    fn found(&self, token: Option<Token>) -> String {
        match token {
            None => "; the file ends".to_owned(),
            Some(_) if !self.quotes => String::new(),
            Some(Token::Word(w)) => format!("; there is {w}"),
            Some(Token::Text(t)) => format!("; there is {t:?}"),
            Some(Token::Number(n)) => format!("; there is {n}"),
            Some(Token::Open) => "; there is [".to_owned(),
            Some(Token::Close) => "; there is ]".to_owned(),
        }
    }

    pub(super) fn peek(&mut self) -> Result<Option<&Token>> {
        if self.ahead.is_none() {
            self.ahead = self.scan()?;
        }
        Ok(self.ahead.as_ref())
    }

    pub(super) fn next(&mut self) -> Result<Option<Token>> {
        match self.ahead.take() {
            Some(token) => Ok(Some(token)),
            None => self.scan(),
        }
    }

    /// A string that must come next.
    pub(super) fn text(&mut self, what: &str) -> Result<String> {
        match self.next()? {
            Some(Token::Text(text)) => Ok(text),
            other => Err(self.place.invalid(format!("{what} in quotes is missing{}", self.found(other)))),
        }
    }

    /// `N` numbers, in brackets or not.
    pub(super) fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let bracket = self.peek()? == Some(&Token::Open);
        if bracket {
            self.next()?;
        }
        let mut values = [0.0; N];
        for value in &mut values {
            match self.next()? {
                Some(Token::Number(v)) => *value = v,
                other => return Err(self.place.invalid(format!("{what} wants {N} numbers{}", self.found(other)))),
            }
        }
        if bracket && self.next()? != Some(Token::Close) {
            return Err(self.place.invalid(format!("{what} wants {N} numbers and a ]")));
        }
        Ok(values)
    }

    fn scan(&mut self) -> Result<Option<Token>> {
        while let Some(&b) = self.text.get(self.at) {
            match b {
                b'\n' => self.place.line += 1,
                b'#' => {
                    let rest = &self.text[self.at..];
                    self.at += rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
                    continue;
                }
                b if b.is_ascii_whitespace() => {}
                _ => break,
            }
            self.at += 1;
        }
        let rest = &self.text[self.at..];
        let (token, length) = match rest {
            [] => return Ok(None),
            [b'[', ..] => (Token::Open, 1),
            [b']', ..] => (Token::Close, 1),
            [b'"', inner @ ..] => match inner.iter().position(|&b| b == b'"' || b == b'\n') {
                Some(end) if inner[end] == b'"' => {
                    (Token::Text(String::from_utf8_lossy(&inner[..end]).into_owned()), end + 2)
                }
                _ => return Err(self.place.invalid("a quote is not closed")),
            },
            _ => {
                let ends = |b: &u8| b.is_ascii_whitespace() || matches!(b, b'[' | b']' | b'"' | b'#');
                let length = rest.iter().position(ends).unwrap_or(rest.len());
                let word = String::from_utf8_lossy(&rest[..length]).into_owned();
                match word.parse::<f64>() {
                    // Words such as "inf" and "nan" are numbers for Rust.
                    Ok(v) if v.abs() <= f64::from(f32::MAX) => (Token::Number(v), length),
                    Ok(_) => {
                        let quote = if self.quotes { &word } else { "this" };
                        return Err(self.place.invalid(format!("{quote} is no finite number")));
                    }
                    Err(_) => (Token::Word(word), length),
                }
            }
        };
        self.at += length;
        Ok(Some(token))
    }
}

/// The values of a parameter.
#[derive(Clone, Debug)]
pub(super) enum Values {
    Numbers(Vec<f64>),
    Texts(Vec<String>),
    Bools(Vec<bool>),
}

/// A parameter: `"rgb reflectance" [ .5 .5 .5 ]`.
#[derive(Clone, Debug)]
pub(super) struct Parameter {
    pub(super) kind: String,
    pub(super) name: String,
    pub(super) values: Values,
    pub(super) place: Place,
    pub(super) used: std::cell::Cell<bool>,
}

/// The parameters that come next.
pub(super) fn parameters(lexer: &mut Lexer) -> Result<Vec<Parameter>> {
    let mut list = Vec::new();
    while let Some(Token::Text(_)) = lexer.peek()? {
        let declaration = lexer.text("a parameter")?;
        let place = lexer.place.clone();
        let Some((kind, name)) = declaration.split_once(char::is_whitespace) else {
            let quote = if lexer.quotes { format!("{declaration:?} ") } else { String::new() };
            return Err(place.invalid(format!("parameter {quote}has no type before its name")));
        };
        let (kind, name) = (kind.to_owned(), name.trim().to_owned());
        let values = values(lexer, &name)?;
        list.push(Parameter { kind, name, values, place, used: std::cell::Cell::new(false) });
    }
    Ok(list)
}

fn values(lexer: &mut Lexer, name: &str) -> Result<Values> {
    let bracket = lexer.peek()? == Some(&Token::Open);
    if bracket {
        lexer.next()?;
    }
    let (mut numbers, mut texts, mut bools) = (Vec::new(), Vec::new(), Vec::new());
    loop {
        match lexer.next()? {
            Some(Token::Close) if bracket => break,
            Some(Token::Number(v)) => numbers.push(v),
            Some(Token::Text(t)) => texts.push(t),
            Some(Token::Word(w)) if w == "true" || w == "false" => bools.push(w == "true"),
            other => {
                let found = lexer.found(other);
                return Err(lexer.place.invalid(format!("parameter {name:?} has a wrong value{found}")));
            }
        }
        if !bracket {
            break;
        }
    }
    match (numbers.is_empty(), texts.is_empty(), bools.is_empty()) {
        (_, true, true) => Ok(Values::Numbers(numbers)),
        (true, false, true) => Ok(Values::Texts(texts)),
        (true, true, false) => Ok(Values::Bools(bools)),
        _ => Err(lexer.place.invalid(format!("parameter {name:?} mixes values of different types"))),
    }
}
