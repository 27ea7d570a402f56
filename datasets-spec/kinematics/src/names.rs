//! Enums whose values have names.

/// Declares an enum whose values have names in tables, files and command lines. `named by METHOD` says which method
/// returns the name of a value.
#[macro_export]
macro_rules! named {
    (
        $(#[$about:meta])*
        $visible:vis enum $kind:ident, named by $name:ident {
            $( $(#[$about_value:meta])* $value:ident = $text:literal, )*
        }
    ) => {
        $(#[$about])*
        $visible enum $kind {
            $( $(#[$about_value])* $value, )*
        }

        impl $kind {
            /// All values, in order.
            $visible const ALL: [Self; [$( $text ),*].len()] = [$( Self::$value ),*];

            /// The name of the value.
            $visible const fn $name(self) -> &'static str {
                match self {
                    $( Self::$value => $text, )*
                }
            }

            /// The value of this name, if there is one.
            $visible fn of_name(name: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|value| value.$name() == name)
            }
        }

        impl std::fmt::Display for $kind {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.$name())
            }
        }
    };
}
