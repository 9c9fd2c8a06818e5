//! `#[derive(ContentHash)]`: walks the fields of a struct or enum in the order they are written.
//!
//! - `#[content_hash(skip)]` on a field of a struct leaves it out of the content.
//! - `#[content_hash(name = "Old")]` on a struct hashes that name instead of its own: a struct's name is part of
//!   every key that holds it, so a struct that is renamed keeps its first name here.

use proc_macro::TokenStream;
use proc_macro2::TokenStream as Tokens;
use quote::{format_ident, quote};
use syn::{Data, DeriveInput, Fields, parse_macro_input};

/// Implements `marf_cache::ContentHash`: field names, variant names and ordinals, and every field's content.
#[proc_macro_derive(ContentHash, attributes(content_hash))]
pub fn derive_content_hash(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    let body = match &input.data {
        Data::Struct(data) => match hashed_name(&input) {
            Ok(name) => struct_body(&name, &data.fields),
            Err(error) => return error.to_compile_error().into(),
        },
        Data::Enum(data) => {
            let arms = data.variants.iter().zip(0_u32..).map(|(variant, ordinal)| {
                let ident = &variant.ident;
                let name = ident.to_string();
                let (pattern, walk) = bound(&name, &variant.fields);
                quote! { Self::#ident #pattern => { visitor.variant(#name, #ordinal); #walk } }
            });
            quote! { match self { #(#arms)* } }
        }
        Data::Union(_) => {
            return syn::Error::new_spanned(&input.ident, "a union has no one content")
                .to_compile_error()
                .into();
        }
    };
    let ident = &input.ident;
    let (generics, types, wheres) = input.generics.split_for_impl();
    quote! {
        impl #generics ::marf_cache::__private::ContentHash for #ident #types #wheres {
            fn walk(&self, visitor: &mut dyn ::marf_cache::__private::Visitor) { #body }
        }
    }
    .into()
}

/// Returns the name under which a struct is hashed: that of `#[content_hash(name = "...")]`, or its own.
fn hashed_name(input: &DeriveInput) -> syn::Result<String> {
    let mut name = input.ident.to_string();
    for attribute in &input.attrs {
        if attribute.path().is_ident("content_hash") {
            attribute.parse_nested_meta(|meta| match meta.path.is_ident("name") {
                true => {
                    name = meta.value()?.parse::<syn::LitStr>()?.value();
                    Ok(())
                }
                false => Err(meta.error("expected `name = \"...\"`")),
            })?;
        }
    }
    Ok(name)
}

fn struct_body(name: &str, fields: &Fields) -> Tokens {
    let fields: Vec<_> = fields
        .iter()
        .enumerate()
        .filter(|(_, field)| !is_skipped(field))
        .collect();
    let count = fields.len();
    let walks = fields.into_iter().map(|(index, field)| {
        let member = field
            .ident
            .clone()
            .map_or_else(|| syn::Member::from(index), syn::Member::Named);
        let label = label(index, field);
        quote! { visitor.field(#label); ::marf_cache::__private::ContentHash::walk(&self.#member, visitor); }
    });
    quote! { visitor.open(#name, #count); #(#walks)* visitor.close(); }
}

fn is_skipped(field: &syn::Field) -> bool {
    let mut ours = field
        .attrs
        .iter()
        .filter(|attribute| attribute.path().is_ident("content_hash"));
    ours.any(|attribute| {
        attribute
            .parse_args::<syn::Ident>()
            .is_ok_and(|word| word == "skip")
    })
}

/// Returns the pattern that binds a variant's fields, and the walk over the bound names.
fn bound(name: &str, fields: &Fields) -> (Tokens, Tokens) {
    let count = fields.len();
    let names: Vec<_> = (0..count).map(|index| format_ident!("field_{index}")).collect();
    let labels = fields
        .iter()
        .enumerate()
        .map(|(index, field)| label(index, field));
    let walk = quote! {
        visitor.open(#name, #count);
        #(visitor.field(#labels); ::marf_cache::__private::ContentHash::walk(#names, visitor);)*
        visitor.close();
    };
    let pattern = match fields {
        Fields::Unit => quote! {},
        Fields::Unnamed(_) => quote! { ( #(#names),* ) },
        Fields::Named(named) => {
            let idents = named.named.iter().map(|field| &field.ident);
            quote! { { #(#idents: #names),* } }
        }
    };
    (pattern, walk)
}

fn label(index: usize, field: &syn::Field) -> String {
    field
        .ident
        .as_ref()
        .map_or_else(|| index.to_string(), ToString::to_string)
}
