//! What the modules of one file declare and use.

use std::collections::{BTreeMap, BTreeSet};

use proc_macro2::{Delimiter, TokenTree};
use syn::spanned::Spanned;

use crate::paths::{Import, Mention, imports, mention};
use crate::rule::{Finding, Rule};
use crate::source::{Source, is_punct};

/// Macros that print to the terminal.
const PRINT: [&str; 4] = ["eprint", "eprintln", "print", "println"];
/// Methods that read to the end of whatever it is.
const READS: [&str; 2] = ["read_to_end", "read_to_string"];

/// A `mod` declaration.
pub(crate) struct Declaration {
    pub name: String,
    /// Whether its content is in this file.
    pub is_inline: bool,
    /// The file that a `path` attribute names.
    pub file: Option<String>,
    pub is_test: bool,
}

/// One module of a file: the file itself or a module written in it.
#[derive(Default)]
pub(crate) struct ModuleText {
    pub declarations: Vec<Declaration>,
    /// Names of functions, types, constants, traits and macros.
    pub items: BTreeSet<String>,
    /// Names of macros that the whole crate sees at its root.
    pub exported_macros: BTreeSet<String>,
    pub imports: Vec<Import>,
    pub mentions: Vec<Mention>,
    /// All words that do not follow `::`.
    pub words: BTreeSet<String>,
}

/// What a file declares and uses, tests left out.
pub(crate) struct Scan {
    /// By the names of the modules written in the file, none for the file itself.
    pub modules: BTreeMap<Vec<String>, ModuleText>,
    pub findings: Vec<Finding>,
}

/// Reads a file.
pub(crate) fn scan(source: &Source) -> Scan {
    let mut found = Scan {
        modules: BTreeMap::new(),
        findings: Vec::new(),
    };
    found.module(&[]);
    found.items(source, &source.syntax.items, &[]);
    let tokens: Vec<TokenTree> = source.tokens.clone().into_iter().collect();
    found.tokens(source, &tokens, &[]);
    found
}

impl Scan {
    fn items(&mut self, source: &Source, items: &[syn::Item], place: &[String]) {
        for item in items {
            if let syn::Item::Mod(module) = item {
                self.declaration(source, module, place);
            } else if !source.is_test(item.span()) {
                self.item(item, place);
            }
        }
    }

    fn declaration(&mut self, source: &Source, module: &syn::ItemMod, place: &[String]) {
        let declaration = Declaration {
            name: module.ident.to_string(),
            is_inline: module.content.is_some(),
            file: module.attrs.iter().find_map(path_attribute),
            is_test: source.is_test(module.mod_token.span),
        };
        self.module(place).declarations.push(declaration);
        if let Some((_, items)) = &module.content {
            let place = below(place, &module.ident.to_string());
            self.module(&place);
            self.items(source, items, &place);
        }
    }

    fn item(&mut self, item: &syn::Item, place: &[String]) {
        let module = self.module(place);
        if let syn::Item::Macro(item) = item
            && let Some(name) = &item.ident
            && item
                .attrs
                .iter()
                .any(|attribute| attribute.path().is_ident("macro_export"))
        {
            module.exported_macros.insert(name.to_string());
        }
        module.items.extend(item_name(item).map(ToString::to_string));
    }

    fn module(&mut self, place: &[String]) -> &mut ModuleText {
        self.modules.entry(place.to_vec()).or_default()
    }

    fn tokens(&mut self, source: &Source, trees: &[TokenTree], place: &[String]) {
        let mut at = 0;
        while at < trees.len() {
            at += match &trees[at] {
                tree if source.is_test(tree.span()) => 1,
                TokenTree::Group(group) => {
                    let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                    if group.delimiter() == Delimiter::Brace {
                        self.boolean_match(source, &trees[..at], &inner);
                    }
                    self.tokens(source, &inner, place);
                    1
                }
                TokenTree::Ident(_) => self.word(source, trees, at, place),
                _ => 1,
            };
        }
    }

    /// Reads what starts with a word. Returns the number of its tokens.
    fn word(&mut self, source: &Source, trees: &[TokenTree], at: usize, place: &[String]) -> usize {
        let word = trees[at].to_string();
        if at > 0 && is_punct(trees.get(at - 1), ':') && at > 1 && is_punct(trees.get(at - 2), ':') {
            return 1;
        }
        let before = at.checked_sub(1).and_then(|before| trees.get(before));
        match (word.as_str(), trees.get(at + 1)) {
            ("use", next) if !is_punct(next, '<') => {
                let length = trees[at..]
                    .iter()
                    .take_while(|tree| !is_punct(Some(tree), ';'))
                    .count();
                let found = imports(&trees[at + 1..at + length], is_public(&trees[..at]));
                self.module(place).imports.extend(found);
                return length;
            }
            ("mod", Some(TokenTree::Ident(name))) => {
                if let Some(TokenTree::Group(group)) = trees.get(at + 2) {
                    let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                    self.tokens(source, &inner, &below(place, &name.to_string()));
                    return 3;
                }
            }
            (name, next) if PRINT.contains(&name) && is_punct(next, '!') => self.findings.push(Finding {
                rule: Rule::Terminal,
                file: source.path.clone(),
                line: trees[at].span().start().line,
                number: 1,
                text: format!("{name}!"),
            }),
            (name, Some(TokenTree::Group(_))) if READS.contains(&name) && is_punct(before, '.') => {
                self.findings.push(Finding {
                    rule: Rule::Reads,
                    file: source.path.clone(),
                    line: trees[at].span().start().line,
                    number: 1,
                    text: format!(".{name}()"),
                })
            }
            _ => {}
        }
        let module = self.module(place);
        module.words.insert(word);
        let Some((found, length)) = mention(&trees[at..]) else {
            return 1;
        };
        module.mentions.push(found);
        length
    }

    fn boolean_match(&mut self, source: &Source, before: &[TokenTree], arms: &[TokenTree]) {
        let number = arms
            .iter()
            .enumerate()
            .filter(|(at, tree)| is_boolean_arm(arms, *at, tree))
            .count();
        if number > 0 {
            let start = before
                .iter()
                .rev()
                .find(|tree| matches!(tree, TokenTree::Ident(word) if word == "match"));
            let line = start.or(before.last()).map_or(1, |tree| tree.span().start().line);
            self.findings.push(Finding {
                rule: Rule::BooleanMatches,
                file: source.path.clone(),
                line,
                number,
                text: "match with arms `true` or `false`".to_owned(),
            });
        }
    }
}

/// Returns whether an arm is `true` or `false`, also with a guard or as one of several patterns.
fn is_boolean_arm(arms: &[TokenTree], at: usize, tree: &TokenTree) -> bool {
    let starts = at == 0
        || is_punct(arms.get(at - 1), ',')
        || is_punct(arms.get(at - 1), '|')
        || matches!(arms.get(at - 1), Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace);
    let continues = is_punct(arms.get(at + 1), '=') && is_punct(arms.get(at + 2), '>')
        || matches!(arms.get(at + 1), Some(TokenTree::Ident(word)) if word == "if");
    starts && continues && matches!(tree, TokenTree::Ident(word) if word == "true" || word == "false")
}

fn is_public(before: &[TokenTree]) -> bool {
    let is_pub = |tree: Option<&TokenTree>| matches!(tree, Some(TokenTree::Ident(word)) if word == "pub");
    match before.last() {
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Parenthesis => {
            is_pub(before.iter().rev().nth(1))
        }
        last => is_pub(last),
    }
}

fn below(place: &[String], name: &str) -> Vec<String> {
    let mut below = place.to_vec();
    below.push(name.to_owned());
    below
}

fn path_attribute(attribute: &syn::Attribute) -> Option<String> {
    let syn::Meta::NameValue(meta) = &attribute.meta else {
        return None;
    };
    match &meta.value {
        syn::Expr::Lit(syn::ExprLit {
            lit: syn::Lit::Str(text),
            ..
        }) if meta.path.is_ident("path") => Some(text.value()),
        _ => None,
    }
}

fn item_name(item: &syn::Item) -> Option<&syn::Ident> {
    match item {
        syn::Item::Const(item) => Some(&item.ident),
        syn::Item::Enum(item) => Some(&item.ident),
        syn::Item::Fn(item) => Some(&item.sig.ident),
        syn::Item::Macro(item) => item.ident.as_ref(),
        syn::Item::Static(item) => Some(&item.ident),
        syn::Item::Struct(item) => Some(&item.ident),
        syn::Item::Trait(item) => Some(&item.ident),
        syn::Item::Type(item) => Some(&item.ident),
        syn::Item::Union(item) => Some(&item.ident),
        _ => None,
    }
}
