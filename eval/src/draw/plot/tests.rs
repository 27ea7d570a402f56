use std::collections::BTreeSet;

use super::*;
use crate::draw::tests::check_nesting;

fn sample(y_scale: Scale, points: Vec<(f64, f64)>) -> Plot {
    let curve = |name: &str, points| Curve {
        name: name.to_owned(),
        points,
        ..Curve::default()
    };
    let val = curve("val \"x\"", vec![(0.0, 0.5), (10.0, 0.25)]);
    Plot {
        title: "Loss <train>".to_owned(),
        x_label: "step".to_owned(),
        y_label: "loss".to_owned(),
        y_scale,
        curves: vec![curve("train", points), val],
        ..Plot::default()
    }
}

#[test]
fn a_legend_stands_below_a_title_that_leaves_no_room_beside_it() {
    let long = "A title that is as wide as the whole drawing is, and so leaves no room";
    // The title and the two names stand side by side, or the title alone.
    for (title, beside) in [("Loss", 3), (long, 1)] {
        let svg = plot(&Plot {
            title: title.to_owned(),
            ..sample(Scale::Linear, vec![(0.0, 1.0), (10.0, 0.5)])
        });
        assert_eq!(svg.matches(r#"y="16.0""#).count(), beside, "{title}");
    }
}

#[test]
fn every_curve_of_many_has_its_own_line_and_a_place_in_the_legend() {
    let curve = |number: usize| Curve {
        name: format!("run of the number {number}"),
        points: vec![(0.0, number as f64), (10.0, number as f64 + 1.0)],
        ..Curve::default()
    };
    let many = Plot {
        curves: (0..20).map(curve).collect(),
        ..sample(Scale::Linear, Vec::new())
    };
    let svg = plot(&many);
    check_nesting(&svg);
    for curve in &many.curves {
        assert!(svg.contains(&format!(">{}<", curve.name)), "{}", curve.name);
    }
    let rows = legend_rows(&many.curves);
    assert_eq!(rows.concat(), (0..20).collect::<Vec<_>>());
    let height = SIZE.y + LEGEND_ROW * rows.len() as f64;
    assert!(svg.contains(&format!(r#"viewBox="0 0 640 {height:.0}""#)));
    let styles: BTreeSet<_> = (0..20)
        .map(|index| (colour(index), dashes(index)))
        .collect();
    assert_eq!(styles.len(), 20);
}

#[test]
fn a_logarithmic_axis_of_a_small_range_has_numbers() {
    let svg = plot(&Plot {
        curves: vec![Curve {
            points: vec![(0.0, 0.24), (10.0, 0.31)],
            ..Curve::default()
        }],
        ..sample(Scale::Log, Vec::new())
    });
    for number in ["0.24", "0.26", "0.28", "0.3"] {
        assert!(svg.contains(&format!(">{number}<")), "{number}: {svg}");
    }
}

#[test]
fn a_heat_map_colours_from_the_lowest_to_the_highest_value() {
    let labels = |labels: [&str; 2]| labels.map(str::to_owned).to_vec();
    let map = HeatMap {
        title: "strength and steps".to_owned(),
        x: ("steps".to_owned(), labels(["10", "20"])),
        y: ("strength".to_owned(), labels(["0.5", "1"])),
        values: vec![4.0, 3.0, f64::NAN, 3.5],
    };
    let svg = heat_map(&map);
    check_nesting(&svg);
    assert_eq!(svg.matches("<rect").count(), 3);
    let place = |colour: Rgb| svg.find(&colour.hex()).expect("drawn");
    assert!(place(HOT) < place(COLD));
    assert!(svg.contains(">3.50<") && !svg.contains("NaN"));
    let empty = HeatMap {
        values: vec![f64::NAN; 4],
        ..map
    };
    assert!(heat_map(&empty).contains("no values yet"));
}

#[test]
fn ticks_are_round_and_within_the_range() {
    assert_eq!(linear_ticks(0.0, 10.0), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
    assert_eq!(linear_ticks(-0.3, 0.3), [-0.2, 0.0, 0.2]);
    assert_eq!(log_ticks(-1.0, 0.0), [0.1, 0.2, 0.5, 1.0]);
    assert_eq!(log_ticks(-4.5, 0.2), [1e-4, 1e-3, 1e-2, 1e-1, 1.0]);
    for (value, span, expected) in [
        (0.25, 1.0, "0.25"),
        (1500.0, 5000.0, "1.5k"),
        (2e6, 2e6, "2M"),
        (0.0, 1.0, "0"),
        (5e-5, 1e-4, "5e-5"),
        (40.0, 100.0, "40"),
        (0.003, 0.003, "0.003"),
    ] {
        assert_eq!(tick_text(value, span), expected);
    }
}

#[test]
fn intervals_are_drawn_and_names_stand_for_numbers() {
    let mut named = sample(Scale::Linear, vec![(0.0, 3.0), (1.0, 4.0), (2.0, 5.0)]);
    named.x_names = ["off", "on", "<both>"].map(str::to_owned).to_vec();
    named.curves[0].intervals = vec![0.5, 0.0, 9.0];
    named.curves.truncate(1);
    let svg = plot(&named);
    check_nesting(&svg);
    assert_eq!(svg.matches("class=\"interval\"").count(), 2);
    assert_eq!(svg.matches("<circle").count(), 3);
    assert!(svg.contains(">off<") && svg.contains(">&lt;both&gt;<"));
    // The axis covers the longest interval.
    let axes = Axes::around(&named).expect("points");
    assert!(axes.y.0 < -4.0 && axes.y.1 > 14.0);
}

#[test]
fn values_without_a_place_interrupt_the_line() {
    let values = [1.0, 0.5, f64::NAN, 0.2, -1.0, 0.1];
    let points: Vec<(f64, f64)> = std::iter::zip([0.0, 1.0, 2.0, 3.0, 4.0, 5.0], values).collect();
    for (scale, lines) in [(Scale::Linear, 2), (Scale::Log, 3)] {
        let axes = Axes::around(&sample(scale, points.clone())).expect("points");
        assert_eq!(axes.path(&points).matches('M').count(), lines);
    }
}

#[test]
fn plots_are_well_formed_and_escaped_even_if_degenerate() {
    let check = |plotted: &Plot| {
        let svg = plot(plotted);
        check_nesting(&svg);
        assert!(
            svg.contains("Loss &lt;train&gt;") && !svg.contains("NaN"),
            "{svg}"
        );
        svg
    };
    let falling = (0..100).map(|i| (f64::from(i), (-f64::from(i) / 20.0).exp()));
    let falling: Vec<(f64, f64)> = falling.collect();
    for scale in [Scale::Linear, Scale::Log] {
        let svg = check(&sample(scale, falling.clone()));
        assert!(svg.contains("val &quot;x&quot;") && !svg.contains("inf"));
    }
    let flat = vec![(1.0, 5.0), (2.0, 5.0)];
    for points in [vec![], vec![(3.0, 2.0)], vec![(0.0, f64::NAN)], flat] {
        let mut only = sample(Scale::Log, points);
        only.curves.truncate(1);
        check(&only);
    }
    check_nesting(&bar_chart(&chart(Vec::new())));
}

#[test]
fn long_curves_keep_their_extremes() {
    let mut points: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
    points[54_321].1 = 7.0;
    points[98_765].1 = -3.0;
    let thin = thinned(&points);
    assert!(thin.len() <= MAX_POINTS);
    assert!(thin.contains(&(54_321.0, 7.0)) && thin.contains(&(98_765.0, -3.0)));
    assert!(thin.is_sorted_by(|a, b| a.0 <= b.0));
}

#[test]
fn every_bar_has_its_label() {
    for count in [3, 26, 200] {
        let bars: Vec<(String, f64)> = (0..count)
            .map(|bar| (format!("throw underarm {bar}"), f64::from(bar + 1)))
            .collect();
        let svg = bar_chart(&chart(bars));
        check_nesting(&svg);
        assert_eq!(svg.matches("<rect").count(), count as usize);
        for bar in 0..count {
            assert!(svg.contains(&format!(">throw underarm {bar}<")), "{bar}");
        }
    }
}

fn chart(bars: Vec<(String, f64)>) -> Bars {
    Bars {
        title: "Lengths".to_owned(),
        x_label: "seconds".to_owned(),
        bars,
    }
}

#[test]
fn a_histogram_counts_every_finite_value_once() {
    let values = [0.3, 1.0, 1.5, 2.0, 4.0, f64::NAN];
    let bins = histogram(&values, 4);
    let labels: Vec<&str> = bins.iter().map(|bin| bin.0.as_str()).collect();
    let counts: Vec<f64> = bins.iter().map(|bin| bin.1).collect();
    assert_eq!(labels, ["0", "1", "2", "3", "4"]);
    assert_eq!(counts, [1.0, 2.0, 1.0, 0.0, 1.0]);
    assert_eq!(histogram(&[5.0; 3], 10), [("5".to_owned(), 3.0)]);
    assert!(histogram(&[], 3).is_empty());
    // 5.8 / 0.1 is less than 58.
    let tenths: Vec<f64> = (0..=20).map(|tenth| f64::from(50 + tenth) / 10.0).collect();
    let of_tenths = histogram(&tenths, 20);
    assert!(of_tenths.iter().all(|(_, count)| *count == 1.0) && of_tenths.len() == 21);
    let svg = bar_chart(&chart(bins));
    check_nesting(&svg);
    assert_eq!(svg.matches("<rect").count(), 5);
}
