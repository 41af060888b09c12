//! Setters of option structs. New versions may add options, so option structs are `#[non_exhaustive]` and have defaults
//! and a method `with_…` for each field.

/// Gives an option struct a method for each field. The method returns the same options with another value of the field.
macro_rules! setters {
    ($options:ident $(<$life:lifetime>)? { $($with:ident($field:ident: $type:ty)),* $(,)? }) => {
        impl $(<$life>)? $options $(<$life>)? {
            $(
                #[doc = concat!("Returns the same options with another [`", stringify!($field), "`](field@", stringify!($options), "::", stringify!($field), ").")]
                #[must_use]
                pub fn $with(mut self, $field: $type) -> Self {
                    self.$field = $field;
                    self
                }
            )*
        }
    };
}
