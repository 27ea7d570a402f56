//! Words for captions of each action.

use datasets_spec::BodyPart;

use super::action::Action;

pub(super) struct Words {
    actions: &'static [Action],
    /// Sentences about the whole body.
    pub(super) sentences: &'static [&'static str],
    /// Phrases about single parts, if a part has a describable action. Each completes "The person is ... with their
    /// <part>." The part `None` means the acting arm.
    pub(super) parts: &'static [(Option<BodyPart>, &'static str)],
}

impl Words {
    pub(super) fn of(action: Action) -> &'static Self {
        let mut all = WORDS.iter();
        let found = all.find(|words| words.actions.contains(&action));
        found.expect("every action has its words")
    }
}

const ACTING: Option<BodyPart> = None;
const BOTH_ARMS: Option<BodyPart> = Some(BodyPart::BothArms);
const LEFT_ARM: Option<BodyPart> = Some(BodyPart::LeftArm);
const RIGHT_ARM: Option<BodyPart> = Some(BodyPart::RightArm);
const LOWER_BODY: Option<BodyPart> = Some(BodyPart::LowerBody);
const UPPER_BODY: Option<BodyPart> = Some(BodyPart::UpperBody);

static WORDS: [Words; 25] = [
    Words {
        actions: &[Action::Walk],
        sentences: &[
            "{who} walks forward{how}",
            "{who} is walking straight ahead{how}",
            "{who} takes several steps forward{how}",
            "{who} walks ahead at an even pace{how}",
        ],
        parts: &[
            (LOWER_BODY, "walking forward{how}"),
            (BOTH_ARMS, "swinging as in walking{how}"),
        ],
    },
    Words {
        actions: &[Action::WaveRight, Action::WaveLeft],
        sentences: &[
            "{who} raises the {side} hand and waves{how}",
            "{who} stands and waves with the {side} hand{how}",
            "{who} greets somebody by waving the {side} arm{how}",
            "with the {side} hand raised, {who} waves{how}",
        ],
        parts: &[
            (ACTING, "waving{how}"),
            (UPPER_BODY, "greeting with a wave{how}"),
            (LOWER_BODY, "standing still{how}"),
        ],
    },
    Words {
        actions: &[Action::Punch],
        sentences: &[
            "{who} boxes{how}, throwing left and right punches",
            "{who} takes a fighting stance and punches the air{how}",
            "{who} throws jabs with the left hand and crosses with the right hand{how}",
        ],
        parts: &[
            (UPPER_BODY, "boxing{how}"),
            (BOTH_ARMS, "punching{how}"),
            (LEFT_ARM, "throwing jabs{how}"),
            (RIGHT_ARM, "throwing cross punches{how}"),
            (LOWER_BODY, "holding a fighting stance{how}"),
        ],
    },
    Words {
        actions: &[Action::Sit],
        sentences: &[
            "{who} sits down{how}, stays seated for a moment and gets up again",
            "{who} sits down on a chair and stands back up{how}",
            "from standing, {who} takes a seat{how} and then rises",
        ],
        parts: &[
            (LOWER_BODY, "sitting down and standing up{how}"),
            (BOTH_ARMS, "reaching for the thighs{how}"),
            (UPPER_BODY, "leaning forward to sit down and get up{how}"),
        ],
    },
    Words {
        actions: &[Action::Run],
        sentences: &[
            "{who} runs forward{how}",
            "{who} is running fast in a straight line{how}",
            "{who} sprints ahead{how}",
        ],
        parts: &[
            (LOWER_BODY, "running{how}"),
            (BOTH_ARMS, "pumping as in running{how}"),
        ],
    },
    Words {
        actions: &[Action::Kick],
        sentences: &[
            "{who} kicks forward with the {side} leg and then with the {other} leg{how}",
            "{who} does two front kicks{how}, first {side}, then {other}",
            "with raised fists, {who} kicks the air twice{how}",
        ],
        parts: &[
            (LOWER_BODY, "kicking forward{how}"),
            (BOTH_ARMS, "keeping up a guard{how}"),
        ],
    },
    Words {
        actions: &[Action::RaiseArms],
        sentences: &[
            "{who} raises both arms above the head and lowers them again, twice{how}",
            "{who} lifts both arms out to the sides and overhead to stretch{how}",
            "{who} stretches with both arms up in the air{how}",
        ],
        parts: &[
            (BOTH_ARMS, "reaching overhead{how}"),
            (UPPER_BODY, "stretching upwards{how}"),
            (LEFT_ARM, "reaching overhead{how}"),
            (RIGHT_ARM, "reaching overhead{how}"),
            (LOWER_BODY, "standing still{how}"),
        ],
    },
    Words {
        actions: &[Action::WalkWave],
        sentences: &[
            "{who} walks forward while waving with the {side} hand{how}",
            "{who} waves the {side} hand and keeps walking{how}",
            "walking ahead, {who} raises the {side} arm to wave{how}",
        ],
        parts: &[
            (ACTING, "waving{how}"),
            (LOWER_BODY, "walking forward{how}"),
            (UPPER_BODY, "greeting with a wave{how}"),
        ],
    },
    Words {
        actions: &[Action::Squat],
        sentences: &[
            "{who} does squats{how}, going down {times}",
            "{who} squats {times} with both arms stretched forward{how}",
            "{who} bends the knees to crouch down and comes up again, {times}{how}",
        ],
        parts: &[
            (LOWER_BODY, "squatting down and coming up{how}"),
            (BOTH_ARMS, "reaching forward{how}"),
            (
                UPPER_BODY,
                "leaning forward with the arms stretched out{how}",
            ),
        ],
    },
    Words {
        actions: &[Action::Throw],
        sentences: &[
            "{who} throws something overarm with the {side} hand, twice{how}",
            "{who} steps forward and throws a ball with the {side} arm{how}",
            "{who} winds up and throws with the {side} hand{how}",
        ],
        parts: &[
            (ACTING, "throwing overarm{how}"),
            (UPPER_BODY, "throwing a ball{how}"),
            (BOTH_ARMS, "winding up and throwing{how}"),
            (LOWER_BODY, "stepping forward into a throw{how}"),
        ],
    },
    Words {
        actions: &[Action::WalkBackward],
        sentences: &[
            "{who} walks backward{how}",
            "{who} steps back several times{how}",
            "{who} is moving backwards on foot{how}",
        ],
        parts: &[
            (LOWER_BODY, "walking backward{how}"),
            (BOTH_ARMS, "swinging loosely{how}"),
        ],
    },
    Words {
        actions: &[Action::Clap],
        sentences: &[
            "{who} claps the hands several times{how}",
            "{who} stands and applauds{how}",
            "{who} is clapping in front of the chest{how}",
        ],
        parts: &[
            (BOTH_ARMS, "clapping{how}"),
            (UPPER_BODY, "applauding{how}"),
            (LOWER_BODY, "standing still{how}"),
        ],
    },
    Words {
        actions: &[Action::Jump],
        sentences: &[
            "{who} jumps up and down on the spot{how}",
            "{who} jumps straight up several times{how}",
            "{who} swings both arms and jumps in place{how}",
        ],
        parts: &[
            (LOWER_BODY, "jumping on the spot{how}"),
            (BOTH_ARMS, "swinging up for a jump{how}"),
        ],
    },
    Words {
        actions: &[Action::Turn],
        sentences: &[
            "{who} turns {turn} to the {side} on the spot{how}",
            "{who} steps around in place to the {side}{how}",
            "{who} makes {turn} to the {side} with small steps{how}",
        ],
        parts: &[(LOWER_BODY, "turning {side} in place{how}")],
    },
    Words {
        actions: &[Action::Jog],
        sentences: &[
            "{who} jogs forward{how}",
            "{who} is jogging at a moderate speed{how}",
            "{who} goes for a light run{how}",
        ],
        parts: &[
            (LOWER_BODY, "jogging{how}"),
            (BOTH_ARMS, "swinging with bent elbows{how}"),
        ],
    },
    Words {
        actions: &[Action::PickUp],
        sentences: &[
            "{who} bends down{how}, picks something up with the {side} hand and straightens",
            "{who} picks up an object from the floor with the {side} hand{how}",
            "{who} crouches to grab something off the ground with the {side} hand{how}",
        ],
        parts: &[
            (ACTING, "picking something up from the floor{how}"),
            (UPPER_BODY, "bending down to pick something up{how}"),
            (LOWER_BODY, "crouching down and standing up{how}"),
        ],
    },
    Words {
        actions: &[Action::WalkCircle],
        sentences: &[
            "{who} walks in a circle to the {side}{how}",
            "{who} is walking around in a {side} curve{how}",
            "{who} walks along a circle, turning {side}{how}",
        ],
        parts: &[
            (LOWER_BODY, "walking in a circle to the {side}{how}"),
            (BOTH_ARMS, "swinging as in walking{how}"),
        ],
    },
    Words {
        actions: &[Action::Reach],
        sentences: &[
            "{who} reaches up with the {side} hand and takes something down, twice{how}",
            "{who} gets something from a high shelf with the {side} hand{how}",
            "{who} stretches the {side} arm upwards and brings it back to the chest{how}",
        ],
        parts: &[
            (ACTING, "reaching up for something{how}"),
            (UPPER_BODY, "reaching up to a high shelf{how}"),
            (LOWER_BODY, "standing on tiptoe and coming down{how}"),
        ],
    },
    Words {
        actions: &[Action::SideStep],
        sentences: &[
            "{who} steps sideways to the {side} and then back to the {other}{how}",
            "{who} shuffles to the {side} and returns{how}",
            "{who} side steps {side}, then {other}{how}",
        ],
        parts: &[(LOWER_BODY, "stepping sideways to the {side} and back{how}")],
    },
    Words {
        actions: &[Action::Bow],
        sentences: &[
            "{who} bows{how} two times",
            "{who} bends forward at the waist in a bow and straightens up{how}",
            "{who} takes a bow{how}, then another one",
        ],
        parts: &[
            (UPPER_BODY, "bowing{how}"),
            (BOTH_ARMS, "staying close to the sides{how}"),
            (LOWER_BODY, "standing still{how}"),
        ],
    },
    Words {
        actions: &[Action::Talk],
        sentences: &[
            "{who} stands and talks{how}, gesturing with both hands",
            "{who} explains something with lively hands{how}",
            "{who} is having a conversation while moving the hands{how}",
        ],
        parts: &[
            (BOTH_ARMS, "gesturing as in a conversation{how}"),
            (UPPER_BODY, "talking and gesturing{how}"),
            (LEFT_ARM, "gesturing{how}"),
            (RIGHT_ARM, "gesturing{how}"),
            (LOWER_BODY, "standing still{how}"),
        ],
    },
    Words {
        actions: &[Action::Hop],
        sentences: &[
            "{who} hops forward with both feet{how}",
            "{who} jumps forward several times{how}",
            "{who} makes a series of jumps ahead{how}",
        ],
        parts: &[
            (LOWER_BODY, "hopping forward{how}"),
            (BOTH_ARMS, "swinging forward for a jump{how}"),
        ],
    },
    Words {
        actions: &[Action::March],
        sentences: &[
            "{who} marches on the spot{how}",
            "{who} lifts the knees high while stepping in place{how}",
            "{who} marches in place, swinging the arms{how}",
        ],
        parts: &[
            (LOWER_BODY, "marching in place{how}"),
            (BOTH_ARMS, "swinging as in marching{how}"),
        ],
    },
    Words {
        actions: &[Action::WalkPhone],
        sentences: &[
            "{who} walks while holding a phone to the {side} ear{how}",
            "{who} is walking and talking on the phone{how}",
            "with the {side} hand at the ear, {who} walks ahead{how}",
        ],
        parts: &[
            (ACTING, "holding a phone to the ear{how}"),
            (UPPER_BODY, "talking on the phone{how}"),
            (LOWER_BODY, "walking forward{how}"),
        ],
    },
    Words {
        actions: &[Action::WalkTurn],
        sentences: &[
            "{who} walks forward, turns around to the {side} and walks back{how}",
            "{who} walks ahead, makes a half turn and returns{how}",
            "{who} walks{how}, turns {side} and goes back",
        ],
        parts: &[
            (LOWER_BODY, "walking forward and back again{how}"),
            (BOTH_ARMS, "swinging as in walking{how}"),
        ],
    },
];
