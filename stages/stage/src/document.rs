use marf_cache::Digest;
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};

use crate::{Ctx, Inputs, NodeSpec, Outputs, StageError};

/// Parameters of a stage that another stage, or a command, may make a node of.
pub trait Params: Serialize + DeserializeOwned + JsonSchema {
    /// Name of the stage in pipeline.toml and in keys.
    const STAGE: &'static str;
}

/// An output of a stage that is a JSON document.
pub trait Document: Serialize + DeserializeOwned {
    /// Name of the stage that writes it.
    const STAGE: &'static str;
    /// Name of the output.
    const OUTPUT: &'static str;

    /// Returns the bytes that are stored: JSON without white space.
    ///
    /// # Errors
    /// A value that JSON cannot hold.
    fn encode(&self) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(self)
    }

    /// Reads stored bytes.
    ///
    /// # Errors
    /// The first field that is missing or of another type.
    fn decode(bytes: &[u8]) -> Result<Self, serde_json::Error> {
        serde_json::from_slice(bytes)
    }
}

impl NodeSpec {
    /// Returns a request to run the stage of `params` on `inputs`.
    ///
    /// # Errors
    /// Parameters that JSON cannot hold.
    pub fn new<P: Params>(name: impl Into<String>, params: &P, inputs: &Inputs) -> Result<Self, StageError> {
        Ok(Self {
            name: name.into(),
            stage: P::STAGE.to_owned(),
            params: serde_json::to_value(params).map_err(|error| StageError::new(error.to_string()))?,
            inputs: inputs.clone(),
        })
    }
}

impl Inputs {
    /// Reads a required input that is a JSON document.
    ///
    /// # Errors
    /// Names the input that is not connected, missing in the store or not such a document.
    pub fn read<D: Document>(&self, ctx: &Ctx<'_>) -> Result<D, StageError> {
        read(ctx, "input", self.required(D::OUTPUT)?)
    }
}

/// Typed access to the outputs of a node.
pub trait TypedOutputs {
    /// Stores a document and lists it under its name.
    ///
    /// # Errors
    /// A value that JSON cannot hold, or a store that cannot be written.
    fn put<D: Document>(&mut self, ctx: &Ctx<'_>, document: &D) -> Result<(), StageError>;

    /// Stores bytes and lists them under `name`.
    ///
    /// # Errors
    /// A store that cannot be written.
    fn put_bytes(&mut self, ctx: &Ctx<'_>, name: impl Into<String>, bytes: &[u8]) -> Result<(), StageError>;

    /// Returns the digest of an output that must be there.
    ///
    /// # Errors
    /// Names the output that is not.
    fn required(&self, name: &str) -> Result<&Digest, StageError>;

    /// Reads a document that must be there.
    ///
    /// # Errors
    /// Names the output that is not there or not such a document.
    fn read<D: Document>(&self, ctx: &Ctx<'_>) -> Result<D, StageError>;
}

impl TypedOutputs for Outputs {
    fn put<D: Document>(&mut self, ctx: &Ctx<'_>, document: &D) -> Result<(), StageError> {
        let bytes = document
            .encode()
            .map_err(|error| StageError::new(format!("output `{}`: {error}", D::OUTPUT)))?;
        self.put_bytes(ctx, D::OUTPUT, &bytes)
    }

    fn put_bytes(&mut self, ctx: &Ctx<'_>, name: impl Into<String>, bytes: &[u8]) -> Result<(), StageError> {
        self.insert(name.into(), ctx.put(bytes)?);
        Ok(())
    }

    fn required(&self, name: &str) -> Result<&Digest, StageError> {
        self.get(name)
            .ok_or_else(|| StageError::new(format!("no output `{name}`")))
    }

    fn read<D: Document>(&self, ctx: &Ctx<'_>) -> Result<D, StageError> {
        read(ctx, "output", TypedOutputs::required(self, D::OUTPUT)?)
    }
}

fn read<D: Document>(ctx: &Ctx<'_>, kind: &str, digest: &Digest) -> Result<D, StageError> {
    let bytes = ctx.get(digest)?;
    D::decode(&bytes).map_err(|error| StageError::new(format!("{kind} `{}`: {error}", D::OUTPUT)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harness::Harness;
    use serde::Deserialize;

    #[derive(Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
    struct Knobs {
        #[serde(skip_serializing_if = "Option::is_none")]
        steps: Option<u64>,
        seed: u64,
    }

    impl Params for Knobs {
        const STAGE: &'static str = "train";
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Figures {
        psnr: f64,
    }

    impl Document for Figures {
        const STAGE: &'static str = "train";
        const OUTPUT: &'static str = "metrics";
    }

    #[test]
    fn a_node_carries_the_name_of_its_stage_and_its_parameters_come_back() {
        let knobs = Knobs {
            steps: None,
            seed: u64::MAX,
        };
        let node = NodeSpec::new("trial-00", &knobs, &Inputs::default()).unwrap();
        assert_eq!((node.name.as_str(), node.stage.as_str()), ("trial-00", "train"));
        assert_eq!(serde_json::from_value::<Knobs>(node.params).unwrap(), knobs);
    }

    #[test]
    fn a_document_comes_back_and_what_is_none_is_named() {
        let harness = Harness::default();
        let (ctx, figures) = (harness.ctx(), Figures { psnr: 21.5 });
        let mut outputs = Outputs::new();
        let absent = TypedOutputs::read::<Figures>(&outputs, &ctx).unwrap_err();
        assert_eq!(absent.to_string(), "no output `metrics`");
        outputs.put(&ctx, &figures).unwrap();
        assert_eq!(&*harness.get(&outputs["metrics"]).unwrap(), br#"{"psnr":21.5}"#);
        assert_eq!(outputs.read::<Figures>(&ctx).unwrap(), figures);
        let inputs = Inputs(outputs.clone());
        assert_eq!(inputs.read::<Figures>(&ctx).unwrap(), figures);
        outputs.put_bytes(&ctx, "metrics", b"[]").unwrap();
        let foreign = outputs.read::<Figures>(&ctx).unwrap_err().to_string();
        assert!(foreign.starts_with("output `metrics`: "), "{foreign}");
    }
}
