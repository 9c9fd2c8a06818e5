//! `#[derive(ContentHash)]`: walks the fields of a struct or enum in the order they are written.
//!
//! A struct's field under `#[content_hash(skip)]` is left out: it is circumstance, not content.

use proc_macro::TokenStream;
use proc_macro2::TokenStream as Tokens;
use quote::{format_ident, quote};
use syn::{Data, DeriveInput, Fields, parse_macro_input};

/// Implements `marf_cache::ContentHash`: field names, variant names and ordinals, and every field's content.
#[proc_macro_derive(ContentHash, attributes(content_hash))]
pub fn derive_content_hash(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    let body = match &input.data {
        Data::Struct(data) => struct_body(&input.ident.to_string(), &data.fields),
        Data::Enum(data) => {
            let arms = data.variants.iter().zip(0_u32..).map(|(variant, ordinal)| {
                let ident = &variant.ident;
                let name = ident.to_string();
                let (pattern, walk) = bound(&name, &variant.fields);
                quote! { Self::#ident #pattern => { listener.variant(#name, #ordinal); #walk } }
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
            fn walk(&self, listener: &mut dyn ::marf_cache::__private::Listener) { #body }
        }
    }
    .into()
}

fn struct_body(name: &str, fields: &Fields) -> Tokens {
    let fields: Vec<_> = fields
        .iter()
        .enumerate()
        .filter(|(_, field)| !is_skipped(field))
        .collect();
    let count = fields.len();
    let walks = fields.into_iter().map(|(index, field)| {
        let member = field.ident.clone().map_or_else(|| syn::Member::from(index), syn::Member::Named);
        let label = label(index, field);
        quote! { listener.field(#label); ::marf_cache::__private::ContentHash::walk(&self.#member, listener); }
    });
    quote! { listener.open(#name, #count); #(#walks)* listener.close(); }
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
        listener.open(#name, #count);
        #(listener.field(#labels); ::marf_cache::__private::ContentHash::walk(#names, listener);)*
        listener.close();
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
