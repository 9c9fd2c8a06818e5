//! One Rust file: its tokens, its syntax tree and what each line holds.

use std::ops::RangeInclusive;

use proc_macro2::{Delimiter, Span, TokenStream, TokenTree};

use crate::checkout::Error;

/// What a line holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Line {
    Blank,
    Comment,
    Code,
    /// Anything that belongs to an item under `#[cfg(test)]`.
    Test,
}

/// A parsed file.
pub(crate) struct Source {
    pub path: String,
    pub tokens: TokenStream,
    pub syntax: syn::File,
    pub lines: Vec<Line>,
}

impl Source {
    /// Parses a file.
    pub(crate) fn parse(path: &str, text: &str) -> Result<Self, Error> {
        let error = |line: usize, reason: String| Error {
            file: format!("{path}:{line}"),
            reason,
        };
        let tokens: TokenStream = text
            .parse()
            .map_err(|source: proc_macro2::LexError| error(source.span().start().line, source.to_string()))?;
        let syntax = syn::parse2(tokens.clone())
            .map_err(|source| error(source.span().start().line, source.to_string()))?;
        let lines = lines(text, &tokens);
        Ok(Self {
            path: path.to_owned(),
            tokens,
            syntax,
            lines,
        })
    }

    /// Returns whether the line where a span starts belongs to a test.
    pub(crate) fn is_test(&self, span: Span) -> bool {
        self.lines.get(span.start().line - 1) == Some(&Line::Test)
    }
}

fn lines(text: &str, tokens: &TokenStream) -> Vec<Line> {
    let texts: Vec<&str> = text.lines().collect();
    let mut lines: Vec<Line> = texts
        .iter()
        .map(|line| {
            if line.trim().is_empty() {
                Line::Blank
            } else {
                Line::Comment
            }
        })
        .collect();
    mark_code(tokens, &texts, &mut lines);
    let mut tests = Vec::new();
    find_tests(tokens, &mut tests);
    for range in tests {
        lines[*range.start() - 1..*range.end()].fill(Line::Test);
    }
    lines
}

fn mark_code(tokens: &TokenStream, texts: &[&str], lines: &mut [Line]) {
    for token in tokens.clone() {
        match &token {
            TokenTree::Group(group) if group.delimiter() == Delimiter::Bracket && is_doc(&token, texts) => {}
            TokenTree::Group(group) => {
                mark(group.span_open(), lines);
                mark_code(&group.stream(), texts, lines);
                mark(group.span_close(), lines);
            }
            TokenTree::Punct(punct) if matches!(punct.as_char(), '#' | '!') && is_doc(&token, texts) => {}
            _ => mark(token.span(), lines),
        }
    }
}

fn mark(span: Span, lines: &mut [Line]) {
    lines[span.start().line - 1..span.end().line].fill(Line::Code);
}

/// Returns whether a token of an attribute is written as a comment: `/// text` is read as `#[doc = "text"]`.
fn is_doc(token: &TokenTree, texts: &[&str]) -> bool {
    let start = token.span().start();
    texts[start.line - 1].chars().nth(start.column) == Some('/')
}

/// Finds the lines of items, fields, arms and statements under `#[cfg(test)]` or `#[test]`.
fn find_tests(tokens: &TokenStream, found: &mut Vec<RangeInclusive<usize>>) {
    let trees: Vec<TokenTree> = tokens.clone().into_iter().collect();
    let is_inner = |part: &[TokenTree]| {
        is_punct(part.first(), '#')
            && is_punct(part.get(1), '!')
            && part.get(2).is_some_and(is_test_attribute)
    };
    if let (Some(first), Some(last), true) = (trees.first(), trees.last(), trees.windows(3).any(is_inner)) {
        found.push(first.span().start().line..=last.span().end().line);
        return;
    }
    let mut at = 0;
    while at < trees.len() {
        let item = at + attributes(&trees[at..]);
        let is_test = trees[at..item].iter().any(is_test_attribute);
        if is_test && item < trees.len() {
            let end = item + item_length(&trees[item..]) - 1;
            found.push(trees[at].span().start().line..=trees[end].span().end().line);
            at = end + 1;
        } else if item > at {
            at = item;
        } else {
            if let TokenTree::Group(group) = &trees[at] {
                find_tests(&group.stream(), found);
            }
            at += 1;
        }
    }
}

/// Returns the number of tokens of the outer attributes that stand first.
fn attributes(trees: &[TokenTree]) -> usize {
    let mut count = 0;
    while is_punct(trees.get(count), '#')
        && matches!(trees.get(count + 1), Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Bracket)
    {
        count += 2;
    }
    count
}

fn is_test_attribute(tree: &TokenTree) -> bool {
    let TokenTree::Group(group) = tree else {
        return false;
    };
    let trees: Vec<TokenTree> = group.stream().into_iter().collect();
    match trees.as_slice() {
        [TokenTree::Ident(name)] => name == "test",
        [TokenTree::Ident(name), TokenTree::Group(predicate)] if name == "cfg" => {
            implies_test(&predicate.stream())
        }
        _ => false,
    }
}

/// Returns whether a predicate of `cfg` holds in tests only: `test`, or `all` with such a part.
fn implies_test(predicate: &TokenStream) -> bool {
    let trees: Vec<TokenTree> = predicate.clone().into_iter().collect();
    trees
        .split(|tree| is_punct(Some(tree), ','))
        .any(|part| match part {
            [TokenTree::Ident(name)] => name == "test",
            [TokenTree::Ident(name), TokenTree::Group(parts)] if name == "all" => {
                implies_test(&parts.stream())
            }
            _ => false,
        })
}

/// Returns the number of tokens of what an attribute belongs to.
fn item_length(trees: &[TokenTree]) -> usize {
    let words: Vec<String> = trees
        .iter()
        .filter_map(|tree| match tree {
            TokenTree::Ident(word) if *word != "pub" => Some(word.to_string()),
            _ => None,
        })
        .take(2)
        .collect();
    let word = |at: usize| words.get(at).map_or("", String::as_str);
    let ends_at_semicolon = match word(0) {
        "use" | "static" | "type" | "let" => true,
        "const" => !matches!(word(1), "fn" | "unsafe" | "async" | "extern"),
        "extern" => word(1) == "crate",
        _ => false,
    };
    let is_item = matches!(
        word(0),
        "fn" | "mod"
            | "impl"
            | "struct"
            | "enum"
            | "union"
            | "trait"
            | "unsafe"
            | "async"
            | "const"
            | "extern"
    );
    let mut angles = 0_usize;
    for (at, tree) in trees.iter().enumerate() {
        let ends = match tree {
            TokenTree::Group(group) => group.delimiter() == Delimiter::Brace && !ends_at_semicolon,
            TokenTree::Punct(punct) => match punct.as_char() {
                ';' => true,
                '<' => {
                    angles += 1;
                    false
                }
                '>' => {
                    angles = angles.saturating_sub(1);
                    false
                }
                ',' => !is_item && !ends_at_semicolon && angles == 0,
                _ => false,
            },
            _ => false,
        };
        if ends {
            return at + 1;
        }
    }
    trees.len()
}

/// Returns whether a token is a punctuation character.
pub(crate) fn is_punct(tree: Option<&TokenTree>, character: char) -> bool {
    matches!(tree, Some(TokenTree::Punct(punct)) if punct.as_char() == character)
}
