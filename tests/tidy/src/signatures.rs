//! Functions, their parameters, and names of functions, modules and types.

use syn::visit::{self, Visit};

use crate::rule::{Finding, Rule};
use crate::source::Source;

/// Most lines of a function, from `fn` to `}`.
const FUNCTION_LINES: usize = 80;
/// Most arguments besides `self`.
const ARGUMENTS: usize = 5;
/// Words that may not name functions and modules.
const NAMES: [&str; 5] = ["again", "as_", "of", "on", "r#as"];
/// States and participles that may not name types.
const STATES: [&str; 8] = [
    "Begun", "Clocked", "New", "Sight", "Still", "Ticking", "Told", "Wanted",
];

/// The functions of a file and what is wrong with its signatures and names, tests left out.
pub(crate) struct Signatures<'a> {
    source: &'a Source,
    /// Lines of each function with a body.
    pub lengths: Vec<usize>,
    pub findings: Vec<Finding>,
}

/// Reads a file.
pub(crate) fn signatures(source: &Source) -> Signatures<'_> {
    let mut found = Signatures {
        source,
        lengths: Vec::new(),
        findings: Vec::new(),
    };
    found.visit_file(&source.syntax);
    found
}

impl Signatures<'_> {
    fn find(&mut self, rule: Rule, line: usize, number: usize, text: String) {
        self.findings.push(Finding {
            rule,
            file: self.source.path.clone(),
            line,
            number,
            text,
        });
    }

    fn function(&mut self, signature: &syn::Signature, block: Option<&syn::Block>) {
        if self.source.is_test(signature.fn_token.span) {
            return;
        }
        let line = signature.fn_token.span.start().line;
        let name = signature.ident.to_string();
        if let Some(block) = block {
            let length = block.brace_token.span.close().end().line - line + 1;
            self.lengths.push(length);
            if length > FUNCTION_LINES {
                self.find(Rule::LongFunctions, line, length, format!("fn {name}"));
            }
        }
        if NAMES.contains(&name.as_str()) {
            self.find(Rule::Names, line, 1, format!("fn {name}"));
        }
        self.parameters(signature);
    }

    fn parameters(&mut self, signature: &syn::Signature) {
        let line = signature.fn_token.span.start().line;
        let name = &signature.ident;
        let typed = signature.inputs.iter().filter_map(|input| match input {
            syn::FnArg::Typed(parameter) => Some(parameter),
            syn::FnArg::Receiver(_) => None,
        });
        let typed: Vec<&syn::PatType> = typed.collect();
        if typed.len() > ARGUMENTS {
            self.find(Rule::Arguments, line, typed.len(), format!("fn {name}"));
        }
        for parameter in typed {
            let line = parameter.colon_token.span.start().line;
            if let Some(tuple) = tuple_pattern(&parameter.pat) {
                self.find(
                    Rule::TupleParameters,
                    line,
                    tuple.elems.len(),
                    format!("fn {name}"),
                );
            }
            if let Some(tuple) = tuple_type(&parameter.ty)
                && tuple.elems.len() > 1
            {
                self.find(Rule::TupleTypes, line, tuple.elems.len(), format!("fn {name}"));
            }
        }
    }

    fn type_name(&mut self, ident: &syn::Ident) {
        if STATES.iter().any(|state| ident == state) && !self.source.is_test(ident.span()) {
            let line = ident.span().start().line;
            self.find(Rule::States, line, 1, format!("type {ident}"));
        }
    }
}

impl<'a> Visit<'a> for Signatures<'_> {
    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        self.function(&item.sig, Some(&item.block));
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'a syn::ImplItemFn) {
        self.function(&item.sig, Some(&item.block));
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'a syn::TraitItemFn) {
        self.function(&item.sig, item.default.as_ref());
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_item_mod(&mut self, item: &'a syn::ItemMod) {
        let name = item.ident.to_string();
        if NAMES.contains(&name.as_str()) && !self.source.is_test(item.mod_token.span) {
            let line = item.mod_token.span.start().line;
            self.find(Rule::Names, line, 1, format!("mod {name}"));
        }
        visit::visit_item_mod(self, item);
    }

    fn visit_item_enum(&mut self, item: &'a syn::ItemEnum) {
        self.type_name(&item.ident);
        visit::visit_item_enum(self, item);
    }

    fn visit_item_struct(&mut self, item: &'a syn::ItemStruct) {
        self.type_name(&item.ident);
        visit::visit_item_struct(self, item);
    }

    fn visit_item_trait(&mut self, item: &'a syn::ItemTrait) {
        self.type_name(&item.ident);
        visit::visit_item_trait(self, item);
    }

    fn visit_item_type(&mut self, item: &'a syn::ItemType) {
        self.type_name(&item.ident);
        visit::visit_item_type(self, item);
    }
}

/// Returns the tuple that a pattern is, also behind a reference.
fn tuple_pattern(pattern: &syn::Pat) -> Option<&syn::PatTuple> {
    match pattern {
        syn::Pat::Tuple(tuple) => Some(tuple),
        syn::Pat::Reference(reference) => tuple_pattern(&reference.pat),
        syn::Pat::Paren(inner) => tuple_pattern(&inner.pat),
        _ => None,
    }
}

/// Returns the tuple that a type is, also behind a reference.
fn tuple_type(of_parameter: &syn::Type) -> Option<&syn::TypeTuple> {
    match of_parameter {
        syn::Type::Tuple(tuple) => Some(tuple),
        syn::Type::Reference(reference) => tuple_type(&reference.elem),
        syn::Type::Paren(inner) => tuple_type(&inner.elem),
        _ => None,
    }
}
