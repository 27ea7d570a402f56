//! User settings that override a preset.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// A setting that does not fit its model.
#[derive(Debug, thiserror::Error)]
#[error("{problem}")]
pub struct SettingError {
    /// Path of keys to the setting; empty if the error is not about one setting.
    pub keys: Vec<String>,
    /// What is wrong with the setting.
    pub problem: String,
}

/// Overrides a preset with the user's values. Setting names of version 0.1 are accepted.
///
/// # Errors
/// A key is unknown, or a value is of another type.
pub fn overlay<T: Serialize + DeserializeOwned>(
    preset: &T,
    own: &Value,
) -> Result<T, SettingError> {
    fn merge(base: &mut Value, own: Value) {
        match (base, own) {
            (Value::Object(base), Value::Object(own)) => {
                for (key, value) in own {
                    merge(base.entry(key).or_insert(Value::Null), value);
                }
            }
            (base, own) => *base = own,
        }
    }
    let over = |own: &Value| {
        let mut own = own.clone();
        rename_former(&mut own);
        let mut settings = serde_json::to_value(preset)?;
        merge(&mut settings, own);
        serde_json::from_value::<T>(settings)
    };
    over(own).map_err(|error| {
        // Serde names at most the last key, so report the first setting that fails by itself.
        let fails_alone = |(keys, alone)| Some((keys, over(&alone).err()?));
        let (keys, error) = settings_of(own)
            .into_iter()
            .find_map(fails_alone)
            .unwrap_or((Vec::new(), error));
        SettingError {
            keys,
            problem: error.to_string(),
        }
    })
}

/// Renames settings of version 0.1 in records and in files of settings.
pub(crate) fn rename_former(settings: &mut Value) {
    let Some(table) = settings.as_object_mut() else {
        return;
    };
    if let Some(size) = table.remove("max_part") {
        table.insert("micro_batch_size".to_owned(), size);
    }
    if let Some(ratio) = table.remove("plain_pairs") {
        table.insert("undonored_ratio".to_owned(), ratio);
    }
    if let Some(steps) = table.remove("num_steps") {
        table.insert(
            "length".to_owned(),
            json!({ "epochs": null, "steps": steps }),
        );
    }
    if let Some(rate) = table.remove("learning_rate") {
        // The pose network's other optimiser settings were fixed.
        let optimizer = json!({
            "learning_rate": rate, "decay": "linear", "warmup_steps": 0, "weight_decay": 0.0,
        });
        table.insert("optimizer".to_owned(), optimizer);
    }
    if let Some(optimizer) = table.get_mut("optimizer").and_then(Value::as_object_mut)
        && let Some(decay) = optimizer.remove("average")
    {
        optimizer.insert("ema_decay".to_owned(), decay);
    }
}

/// The settings of a document, each with its path of keys and as a document that holds only this setting.
fn settings_of(document: &Value) -> Vec<(Vec<String>, Value)> {
    let Value::Object(fields) = document else {
        return vec![(Vec::new(), document.clone())];
    };
    let mut found = Vec::new();
    for (key, value) in fields {
        for (mut keys, value) in settings_of(value) {
            keys.insert(0, key.clone());
            let document = Value::Object([(key.clone(), value)].into_iter().collect());
            found.push((keys, document));
        }
    }
    found
}
