use std::borrow::Cow;

use schemars::{JsonSchema, Schema, generate::SchemaSettings};
use serde::{Serialize, de::DeserializeOwned};

use crate::{ArchiveContext, Stage, error::ParamError};

/// An input of a stage: the key that names the upstream node, and the output of that node that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Port {
    /// Key in pipeline.toml that names the upstream node (`input`, `params`).
    pub key: &'static str,
    /// Name of the upstream output, and the name under which the stage reads it.
    pub output: &'static str,
    /// Whether the stage cannot run without it.
    pub required: bool,
    /// Whether it may name several nodes. The output of each is an input of its own ([`Port::input`]).
    pub many: bool,
    /// Keys of the node, parameters or ports, that this input decides: they may not be set together with it.
    pub decides: &'static [&'static str],
    /// What to write if the named node does not give the output, for people.
    pub hint: Option<&'static str>,
}

impl Port {
    /// Returns an input that the stage cannot run without.
    pub const fn required(key: &'static str, output: &'static str) -> Self {
        Self {
            key,
            output,
            required: true,
            many: false,
            decides: &[],
            hint: None,
        }
    }

    /// Returns an input from one or several nodes, at least one.
    pub const fn many(key: &'static str, output: &'static str) -> Self {
        Self {
            many: true,
            ..Self::required(key, output)
        }
    }

    /// Returns an input that may be absent.
    pub const fn optional(key: &'static str, output: &'static str) -> Self {
        Self {
            key,
            output,
            required: false,
            many: false,
            decides: &[],
            hint: None,
        }
    }

    /// Returns the name under which the stage reads what a node gives: that of the output, and `output/NODE` where several nodes give it.
    pub fn input(&self, upstream: &str) -> Cow<'static, str> {
        if self.many {
            Cow::Owned(format!("{}/{upstream}", self.output))
        } else {
            Cow::Borrowed(self.output)
        }
    }

    /// Returns the input with a hint for the error about a node that does not give the output.
    #[must_use]
    pub const fn with_hint(self, hint: &'static str) -> Self {
        Self {
            hint: Some(hint),
            ..self
        }
    }

    /// Returns the input as one that decides what these keys of the node would.
    #[must_use]
    pub const fn deciding(self, keys: &'static [&'static str]) -> Self {
        Self {
            decides: keys,
            ..self
        }
    }
}

/// A stage as a type: its name, version, parameters and ports. Most stages are a row of [`stage!`](crate::stage!).
pub trait Define: Stage + Sized + 'static {
    /// Its section in pipeline.toml. Doc comments of its fields become the help text.
    type Params: DeserializeOwned + JsonSchema;
    /// Name in pipeline.toml and in keys. If the parameters are [`crate::Params`], it is their `STAGE`.
    const NAME: &'static str;
    /// One line for people.
    const ABOUT: &'static str;
    /// Raised by hand when the stage may give another result.
    const VERSION: u32;
    /// Of a filter: what to write in its table so that photos which it rejects are kept, for people.
    const RELAX: Option<&'static str> = None;
    /// Inputs.
    const PORTS: &'static [Port];
    /// Names of its outputs. One that ends with `/` represents any number of outputs below it, including
    /// zero.
    const OUTPUTS: &'static [&'static str];

    /// Checks the parameters.
    ///
    /// # Errors
    /// Names the key that is out of range.
    fn new(params: Self::Params) -> Result<Self, ParamError>;

    /// As [`Define::new`], for a stage that reads an archive. All others ignore the context.
    ///
    /// # Errors
    /// Names the key that is out of range.
    fn with_archive(params: Self::Params, _context: ArchiveContext) -> Result<Self, ParamError> {
        Self::new(params)
    }
}

/// A row of the registry of stages.
#[derive(Clone, Copy)]
pub struct StageDef {
    /// Name in pipeline.toml and in keys.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Raised by hand when the stage may give another result.
    pub version: u32,
    /// Of a filter: what to write in its table so that photos which it rejects are kept, for people.
    pub relax: Option<&'static str>,
    /// Inputs.
    pub ports: &'static [Port],
    /// Names of its outputs. One that ends with `/` represents any number of outputs below it, including
    /// zero.
    pub outputs: &'static [&'static str],
    /// JSON schema of its parameters.
    pub schema: fn() -> Schema,
    /// Checks parameters and returns the stage, ready to run.
    pub bind: fn(serde_json::Value) -> Result<Box<dyn Stage>, ParamError>,
    /// As `bind`, with the context of the archive that the stage reads.
    pub bind_archive: fn(serde_json::Value, ArchiveContext) -> Result<Box<dyn Stage>, ParamError>,
}

/// Returns the registry row of a stage.
pub const fn define<S: Define>() -> StageDef {
    StageDef {
        name: S::NAME,
        about: S::ABOUT,
        version: S::VERSION,
        relax: S::RELAX,
        ports: S::PORTS,
        outputs: S::OUTPUTS,
        schema: schema_of::<S::Params>,
        bind: |params| Ok(Box::new(S::new(from_json(params)?)?)),
        bind_archive: |params, context| Ok(Box::new(S::with_archive(from_json(params)?, context)?)),
    }
}

/// Returns the JSON schema of a table of parameters, inlined, so that it can be nested in the schema of the whole file.
pub fn schema_of<P: JsonSchema>() -> Schema {
    let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
    settings.into_generator().into_root_schema_for::<P>()
}

/// Returns parameters as JSON for a key, without the keys that change no result (`device`: the backend has its own place in the key).
/// A key in a nested table has its path (`train.device`).
///
/// Numbers that JSON cannot hold, NaN and infinities, become `null`. Stages reject them before.
pub fn key_params(params: &impl Serialize, without: &[&str]) -> serde_json::Value {
    let mut json = serde_json::to_value(params).unwrap_or_default();
    without.iter().for_each(|path| remove(&mut json, path));
    json
}

fn remove(json: &mut serde_json::Value, path: &str) {
    match path.split_once('.') {
        Some((table, rest)) => json
            .get_mut(table)
            .into_iter()
            .for_each(|table| remove(table, rest)),
        None => drop(json.as_object_mut().and_then(|table| table.remove(path))),
    }
}

/// Reads a table of parameters.
///
/// # Errors
/// Names the key whose value cannot be read.
pub fn from_json<P: DeserializeOwned>(params: serde_json::Value) -> Result<P, ParamError> {
    serde_path_to_error::deserialize(params).map_err(|error| {
        ParamError::new(
            error.path().to_string().trim_start_matches('.'),
            error.inner().to_string(),
        )
    })
}

/// Defines a stage that holds its parameters. They implement [`Params`](crate::Params) and have a method `check`.
///
/// `stage! { Video { params: VideoParams }, Set, Threads::One, about: …, version: 1, ports: […], outputs: […] }` implements [`Define`]
/// and [`Stage`] for `struct Video { params: VideoParams }`. `Set` is its variant of [`Work`](crate::Work). Further rows:
/// - `without: "device"`: a parameter that is in no key.
/// - `device: device`: the parameter that chooses the backend. It is in no key either.
/// - `{ … }`: further methods of [`Stage`].
#[macro_export]
macro_rules! stage {
    (
        $stage:ident { $field:tt: $params:ty },
        $work:ident,
        $threads:expr,
        about: $about:expr,
        version: $version:expr,
        ports: $ports:expr,
        outputs: $outputs:expr
        $(, without: $without:literal)?
        $(, device: $device:ident $(. $inner:ident)*)?
        $(, { $($method:tt)* })?
        $(,)?
    ) => {
        impl $crate::Define for $stage {
            type Params = $params;
            const NAME: &'static str = <$params as $crate::Params>::STAGE;
            const ABOUT: &'static str = $about;
            const VERSION: u32 = $version;
            const PORTS: &'static [$crate::Port] = &$ports;
            const OUTPUTS: &'static [&'static str] = &$outputs;

            fn new(params: $params) -> Result<Self, $crate::ParamError> {
                params.check()?;
                Ok(Self { $field: params })
            }
        }

        impl $crate::Stage for $stage {
            fn params(&self) -> ::serde_json::Value {
                let without: &[&str] = &[$($without)? $(concat!(stringify!($device) $(, ".", stringify!($inner))*))?];
                $crate::key_params(&self.$field, without)
            }

            fn work(&self) -> $crate::Work<'_> {
                $crate::Work::$work(self)
            }

            fn threads(&self) -> $crate::Threads {
                $threads
            }

            $(
                fn backend_id(&self) -> Option<String> {
                    ::marf_field_gpu::backend_id(&self.$field.$device$(.$inner)*)
                }

                fn backend_id_on(&self, gpu: Option<&str>) -> Result<Option<String>, $crate::StageError> {
                    self.$field.$device$(.$inner)*.backend_id_on(gpu).map_err($crate::StageError::new)
                }
            )?

            $($($method)*)?
        }
    };
}
