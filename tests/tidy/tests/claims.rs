//! Every message with a number or a claim in it has a test that fails if it is false.
//!
//! `tests/claims.txt` lists the messages by file and function, each with its test or with none. `UPDATE_CLAIMS=1 cargo test -p marf-tidy
//! --test claims` adds new messages without a test and removes those that are gone. Then name their tests.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use marf_tidy::is_claim;
use proc_macro2::{Delimiter, TokenStream, TokenTree};
use syn::visit::{self, Visit};

/// Messages without a test. The limit only goes down.
const UNTESTED: usize = 123;
/// Code whose messages are not those of the program.
const OUTSIDE: [&str; 6] = ["benches/", "fuzz/", "labs/", "shaders/", "target/", "tests/"];
/// Macros and methods whose text only a programmer reads: it stands where the program is wrong.
const INTERNAL: [&str; 6] = [
    "assert",
    "assert_eq",
    "debug_assert",
    "digest_of",
    "expect",
    "unreachable",
];

/// Messages by file and function, each with its tests.
type Claims = BTreeMap<String, BTreeMap<String, BTreeSet<String>>>;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Collects the messages of one file.
struct Messages<'a> {
    file: &'a str,
    /// Type and function around the present place.
    names: Vec<String>,
    found: &'a mut Claims,
}

impl Messages<'_> {
    fn add(&mut self, tokens: TokenStream) {
        let mut sentence = String::new();
        let mut sentences = Vec::new();
        let mut is_internal = false;
        for token in tokens {
            match token {
                TokenTree::Literal(literal) => match syn::parse_str::<syn::LitStr>(&literal.to_string()) {
                    Ok(text) => sentence += &text.value(),
                    Err(_) => sentences.push(std::mem::take(&mut sentence)),
                },
                TokenTree::Group(group) if is_internal => {
                    sentences.push(std::mem::take(&mut sentence));
                    is_internal = group.delimiter() != Delimiter::Parenthesis;
                }
                TokenTree::Group(group) => {
                    // In `html!` a value stands in brackets between its words.
                    let is_value = group.delimiter() == Delimiter::Parenthesis && !sentence.is_empty();
                    if is_value {
                        sentence += "{}";
                    } else {
                        sentences.push(std::mem::take(&mut sentence));
                    }
                    // Comments on items within a function are attributes `[doc = "…"]`.
                    if !group.stream().to_string().starts_with("doc ") {
                        self.add(group.stream());
                    }
                }
                other => {
                    // The `!` of a macro follows its name.
                    is_internal = match &other {
                        TokenTree::Ident(name) => INTERNAL.iter().any(|internal| name == internal),
                        _ => is_internal && other.to_string() == "!",
                    };
                    sentences.push(std::mem::take(&mut sentence));
                }
            }
        }
        sentences.push(sentence);
        let place = format!("{} {}", self.file, self.names.join("::"));
        for sentence in sentences.into_iter().filter(|text| is_claim(text)) {
            let sentence = sentence.trim().replace('\n', "\\n");
            self.found
                .entry(place.clone())
                .or_default()
                .entry(sentence)
                .or_default();
        }
    }

    fn within(&mut self, name: String, tokens: impl FnOnce(&mut Self)) {
        self.names.push(name);
        tokens(self);
        self.names.pop();
    }

    /// Adds the messages of `#[error("…")]`.
    fn add_errors(&mut self, attributes: &[syn::Attribute]) {
        for attribute in attributes
            .iter()
            .filter(|attribute| attribute.path().is_ident("error"))
        {
            if let syn::Meta::List(list) = &attribute.meta {
                self.add(list.tokens.clone());
            }
        }
    }

    /// Adds the help that clap takes from the comments of arguments. It says what an argument is for, and claims by its numbers.
    fn add_help(&mut self, attributes: &[syn::Attribute]) {
        let text: Vec<String> = attributes.iter().filter_map(doc).collect();
        let text = text.join(" ");
        if text.contains(|letter: char| letter.is_ascii_digit()) {
            self.add(TokenStream::from(TokenTree::Literal(
                proc_macro2::Literal::string(&text),
            )));
        }
    }
}

fn doc(attribute: &syn::Attribute) -> Option<String> {
    match &attribute.meta {
        syn::Meta::NameValue(pair) if attribute.path().is_ident("doc") => match &pair.value {
            syn::Expr::Lit(syn::ExprLit {
                lit: syn::Lit::Str(text),
                ..
            }) => Some(text.value().trim().to_owned()),
            _ => None,
        },
        _ => None,
    }
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    let text = |attribute: &syn::Attribute| match &attribute.meta {
        syn::Meta::List(list) => list.tokens.to_string(),
        _ => String::new(),
    };
    attributes
        .iter()
        .any(|attribute| attribute.path().is_ident("cfg") && text(attribute).contains("test"))
}

impl<'ast> Visit<'ast> for Messages<'_> {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !is_test(&item.attrs) {
            visit::visit_item_mod(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let name = match &*item.self_ty {
            syn::Type::Path(path) => path.path.segments.last().map(|last| last.ident.to_string()),
            _ => None,
        };
        self.within(name.unwrap_or_default(), |found| {
            visit::visit_item_impl(found, item)
        });
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        if !is_test(&item.attrs) {
            self.within(item.sig.ident.to_string(), |found| found.add(tokens(&item.block)));
        }
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        self.within(item.sig.ident.to_string(), |found| found.add(tokens(&item.block)));
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        self.within(item.sig.ident.to_string(), |found| {
            found.add(tokens(&item.default))
        });
    }

    fn visit_item_const(&mut self, item: &'ast syn::ItemConst) {
        if !is_test(&item.attrs) {
            self.within(item.ident.to_string(), |found| found.add(tokens(&item.expr)));
        }
    }

    fn visit_item_static(&mut self, item: &'ast syn::ItemStatic) {
        if !is_test(&item.attrs) {
            self.within(item.ident.to_string(), |found| found.add(tokens(&item.expr)));
        }
    }

    fn visit_impl_item_const(&mut self, item: &'ast syn::ImplItemConst) {
        self.within(item.ident.to_string(), |found| found.add(tokens(&item.expr)));
    }

    fn visit_item_enum(&mut self, item: &'ast syn::ItemEnum) {
        self.within(item.ident.to_string(), |found| {
            for variant in &item.variants {
                found.add_errors(&variant.attrs);
                if found.file.starts_with("src/cli/") {
                    found.add_help(&variant.attrs);
                }
            }
        });
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        self.within(item.ident.to_string(), |found| {
            found.add_errors(&item.attrs);
            let arguments = item.fields.iter().filter(|_| found.file.starts_with("src/cli/"));
            for field in arguments.collect::<Vec<_>>() {
                found.add_help(&field.attrs);
            }
        });
    }

    fn visit_item_macro(&mut self, item: &'ast syn::ItemMacro) {
        let name = item.mac.path.segments.last().map(|last| last.ident.to_string());
        self.within(name.unwrap_or_default(), |found| {
            found.add(item.mac.tokens.clone())
        });
    }
}

fn tokens(part: &impl quote::ToTokens) -> TokenStream {
    part.to_token_stream()
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && !name.starts_with('.') && name != "target" {
            files(&path, found);
        } else if name.ends_with(".rs") {
            found.push(path);
        }
    }
}

/// Returns the files of modules that are compiled for tests alone: `#[cfg(test)] mod NAME;`.
fn test_modules(file: &Path, parsed: &syn::File) -> Vec<PathBuf> {
    let stem = file.file_stem().unwrap();
    let folder = if ["lib", "main", "mod"].iter().any(|name| stem == *name) {
        file.parent().unwrap().to_owned()
    } else {
        file.with_extension("")
    };
    let modules = parsed.items.iter().filter_map(|item| match item {
        syn::Item::Mod(module) if module.content.is_none() && is_test(&module.attrs) => {
            Some(module.ident.to_string())
        }
        _ => None,
    });
    modules.map(|name| folder.join(name)).collect()
}

/// Returns the messages of the program, without tests.
fn found() -> Claims {
    let (root, mut paths) = (root(), Vec::new());
    files(&root, &mut paths);
    let mut parsed = BTreeMap::new();
    for path in paths {
        let file = path
            .strip_prefix(&root)
            .unwrap()
            .to_string_lossy()
            .replace('\\', "/");
        let is_outside = OUTSIDE
            .iter()
            .any(|folder| file.starts_with(folder) || file.contains(&format!("/{folder}")));
        if !is_outside {
            parsed.insert(
                file,
                syn::parse_file(&std::fs::read_to_string(&path).unwrap()).unwrap(),
            );
        }
    }
    let tests: Vec<PathBuf> = parsed
        .iter()
        .flat_map(|(file, code)| test_modules(Path::new(file), code))
        .collect();
    let mut claims = Claims::new();
    for (file, code) in &parsed {
        if !tests
            .iter()
            .any(|module| Path::new(file).with_extension("").starts_with(module))
        {
            let (names, found) = (Vec::new(), &mut claims);
            Messages { file, names, found }.visit_file(code);
        }
    }
    claims
}

fn list() -> PathBuf {
    root().join("tests/claims.txt")
}

/// Returns the committed list.
fn listed() -> Claims {
    let text = std::fs::read_to_string(list()).unwrap_or_default();
    let mut claims = Claims::new();
    let (mut place, mut claim) = (String::new(), String::new());
    for line in text.lines() {
        if let Some(test) = line.strip_prefix("    = ") {
            claims
                .get_mut(&place)
                .unwrap()
                .get_mut(&claim)
                .unwrap()
                .insert(test.to_owned());
        } else if let Some(sentence) = line.strip_prefix("  ") {
            sentence.clone_into(&mut claim);
            claims
                .entry(place.clone())
                .or_default()
                .entry(claim.clone())
                .or_default();
        } else {
            line.clone_into(&mut place);
        }
    }
    claims
}

fn each(claims: &Claims) -> impl Iterator<Item = (&String, &String, &BTreeSet<String>)> {
    let sentences = claims
        .iter()
        .flat_map(|(place, of_place)| of_place.iter().map(move |pair| (place, pair)));
    sentences.map(|(place, (sentence, tests))| (place, sentence, tests))
}

fn text(claims: &Claims) -> String {
    let mut text = String::new();
    for (place, sentences) in claims {
        writeln!(text, "{place}").unwrap();
        for (sentence, tests) in sentences {
            writeln!(text, "  {sentence}").unwrap();
            tests
                .iter()
                .for_each(|test| writeln!(text, "    = {test}").unwrap());
        }
    }
    text
}

#[test]
fn every_claim_of_a_message_is_listed_and_every_listed_claim_is_made() {
    let (mut found, listed) = (found(), listed());
    for (place, sentence, tests) in each(&listed) {
        if let Some(known) = found.get_mut(place).and_then(|place| place.get_mut(sentence)) {
            known.clone_from(tests);
        }
    }
    if std::env::var_os("UPDATE_CLAIMS").is_some() {
        std::fs::write(list(), text(&found)).unwrap();
        return;
    }
    let names = |claims: &Claims| -> BTreeSet<String> {
        each(claims)
            .map(|(place, sentence, _)| format!("{place}: {sentence}"))
            .collect()
    };
    let (made, known) = (names(&found), names(&listed));
    let new: Vec<_> = made.difference(&known).collect();
    let gone: Vec<_> = known.difference(&made).collect();
    assert!(
        new.is_empty() && gone.is_empty(),
        "not in tests/claims.txt: {new:#?}\nno longer in the code: {gone:#?}\nUPDATE_CLAIMS=1 corrects the list. Then name the tests of the new ones"
    );
}

#[test]
fn the_test_of_every_claim_exists_and_no_more_claims_than_before_have_none() {
    let listed = listed();
    let mut texts = BTreeMap::new();
    for test in each(&listed).flat_map(|(_, _, tests)| tests) {
        let (file, name) = test.split_once(' ').unwrap();
        let text = texts
            .entry(file.to_owned())
            .or_insert_with(|| std::fs::read_to_string(root().join(file)).unwrap_or_default());
        // A test of its own, or a row of a macro that makes tests.
        let forms = [format!("fn {name}("), format!("\n    {name}: ")];
        assert!(
            forms.iter().any(|form| text.contains(form)),
            "there is no test `{name}` in {file}"
        );
    }
    let (all, untested) = (
        each(&listed).count(),
        each(&listed).filter(|claim| claim.2.is_empty()).count(),
    );
    assert!(
        untested <= UNTESTED,
        "{untested} of {all} claims have no test, and the limit is {UNTESTED}: name or write tests"
    );
    assert!(
        untested + 20 > UNTESTED,
        "{untested} of {all} claims have no test: lower the limit of {UNTESTED}"
    );
}
