//! Where the parameters of a measurement come from.

/// The attributes of a sensor, by their dotted names, such as "measurement.dropout".
pub trait Parameters {
    type Error;

    /// The value of an attribute; `Value::Nothing` also where an attribute on the way to it is nothing.
    fn value(&self, name: &'static str) -> Result<Value, Self::Error>;

    /// The error for a value that an attribute cannot have.
    fn unexpected(&self, name: &'static str, value: Value) -> Self::Error;

    fn number(&self, name: &'static str) -> Result<f64, Self::Error> {
        self.as_number(name, self.value(name)?)
    }

    fn optional_number(&self, name: &'static str) -> Result<Option<f64>, Self::Error> {
        match self.value(name)? {
            Value::Nothing => Ok(None),
            value => self.as_number(name, value).map(Some),
        }
    }

    /// The number that the value of an attribute is.
    fn as_number(&self, name: &'static str, value: Value) -> Result<f64, Self::Error> {
        match value {
            Value::Number(number) => Ok(number),
            other => Err(self.unexpected(name, other)),
        }
    }
}

/// The value of an attribute.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    Nothing,
    Number(f64),
    Text(String),
    Numbers(Vec<f64>),
    Rows(Vec<[f64; 2]>),
}
