// Constants of objects. What a caller may vary is in ObjectParameters and TrackParameters; how
// objects are sampled and matched is in geometry/constants.hpp.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

// --- Objects of a sweep ---

/// Fewer connected points are no object: their returns are isolated.
constexpr std::uint32_t kMinDetectionPoints = 5;
/// Pieces of fewer points are also connected across discontinuities, up to this share of their
/// range [m/m].
constexpr float kPieceDistanceGrowth = 0.03f;
/// Wider objects are no road users [m]: longer than any truck, they only occupy space.
constexpr float kMaxObjectWidth = 25.0f;
/// Isolated points this near to a dynamic object belong to it [m].
constexpr float kObjectMargin = 0.2f;
/// The place of an object was free if that of this share of its area was.
constexpr float kMinFreeShare = 0.5f;
/// What was always there may have been hidden, but for this share of its points.
constexpr double kStandingShare = 0.25;
/// Of an object that was always there edges seem free, at most this share of its area.
constexpr float kFreeEdges = 0.15f;
/// With a larger share of isolated returns it is porous: rays pass through twigs and fences.
constexpr float kMaxIsolatedShare = 0.1f;
/// An object is kept as at most this many samples. What is higher than a van, or higher than a car
/// and longer than a van [m], has more that are so far apart [m], up to 500: farther apart, those
/// of a lorry miss those of the next sweep by more than kMatchDistance where each sweep sees other
/// parts of it. A row of parked cars needs no more, and with them the car that arrives takes its
/// neighbors along; a van and the car beside it are 8 m long.
constexpr std::size_t kMaxSamples = 100;
constexpr float kMaxCarHeight = 2.2f, kMaxVanHeight = 2.8f, kMaxVanLength = 10.0f;
constexpr float kMaxSampleSpacing = 0.33f;
/// An object borders on what is this much nearer or farther [m]; that much apart are the samples of
/// its borders [m], and so many are kept.
constexpr float kMinBorderDepth = 0.5f, kBorderSpacing = 0.1f;
constexpr std::size_t kMaxBorderSamples = 30;
/// Spacing of the samples of objects wider than kMaxObjectWidth [m].
constexpr float kWideSampleSpacing = 0.25f;
/// Ground is kept as cells of this edge, so far around the LiDAR; an object stands on what lies
/// within kGroundReach of it [m].
constexpr float kGroundCell = 1.0f, kGroundRange = 100.0f, kGroundReach = 5.0f;
/// How exactly a cell tells the height at its place [m], and how steep ground may be [m/m].
constexpr double kGroundDeviation = 0.1, kGroundSlope = 0.1;

// --- Tracking ---

/// So many tracks are made into paths at once.
constexpr std::size_t kTracksAtOnce = 32;
/// Flatter objects are ground that the ground growing missed [m].
constexpr float kMinTrackedHeight = 0.15f;
/// Narrower objects are static [m]: poles.
constexpr float kMinTrackedWidth = 0.3f;
/// How much rounding may move a box [m].
constexpr float kRoundingMargin = 0.1f;
/// An object is searched this far around its predicted box [m].
constexpr float kSearchMargin = 0.5f;
/// Samples match exactly within this horizontal distance [m]: they are this far apart at most.
constexpr float kLevelDistance = 0.2f;
/// Weight of the samples that match beside those that match exactly: it decides between few.
constexpr float kNearWeight = 0.1f;
/// Share of an object's samples that have to match the track it belongs to.
constexpr float kMinMemberShare = 0.6f;
/// Share of min_distance that a track goes while votes call it dynamic.
constexpr float kMinVotedDistanceShare = 0.3f;
/// Below this speed key frames near in time saw the object at its place [m/s].
constexpr float kSlow = 2;
/// Slower objects stand; they may stay hidden for long [m/s].
constexpr float kStanding = 0.5f;

/// What was seen once may be anywhere that max_speed reaches, so it is looked for in so many sweeps
/// only: with each one there are more places, and parked cars in some of them.
constexpr std::size_t kMaxSweepsUnknown = 3;

/// No road user speeds up, brakes or bends its path harder [m/s^2].
constexpr float kMaxAcceleration = 8;
/// Less than this share of an object's area is a part of it.
constexpr float kPartialShare = 0.5f;
/// How wrong a shift may be [m]; far away as much as rays are apart [rad]: 0.3 degrees.
constexpr float kShiftError = 0.15f, kRaySpacing = 0.005f;
/// The first shift of a track may be wrong by this share of itself if the two sweeps show no common
/// part of the object.
constexpr float kFirstShiftError = 0.3f;

/// What the LiDAR sees within this distance [m] at the same place of its own frame, in this share
/// of the sweeps, while it goes so far [m], is the vehicle that carries it. Nothing else keeps
/// beside it for a whole drive.
constexpr float kEgoReach = 3, kEgoShare = 0.8f, kMinEgoPath = 5;

// --- Motion of a track ---

/// One object never looks larger than its size times the factor, plus the margin [m].
constexpr float kMaxSizeFactor = 1.5f, kMaxSizeMargin = 0.5f;
/// A track supports as much static area as was passing in one sweep, or in all sweeps together
/// divided by this.
constexpr float kTotalSupportDivisor = 8;
/// The box of a standing object is collected over this many times the window.
constexpr double kStandingWindowFactor = 3;
/// Objects this wide in this share of their observations are rigid [m]: wider than a person.
constexpr float kMinRigidWidth = 1.4f;
constexpr double kRigidQuantile = 0.75;
/// How exactly a shift from sweep to sweep, and the height of the lowest point, tell the position
/// [m].
constexpr double kShiftDeviation = 0.08, kHeightDeviation = 0.15;
/// How far above the ground an object seems to end where no ground was seen around it [m]: feet and
/// wheels are often hidden.
constexpr double kHiddenDeviation = 0.5;
/// Errors of shifts add up: after n sweeps to the root of n times this [m].
constexpr double kShiftDrift = 0.03;
/// How much a road user changes its acceleration in a second [m/s^2]: firm braking is 4. Roads
/// bend far less up and down.
constexpr double kHorizontalChange = 3, kVerticalChange = 0.3;
/// How much it changes its rate of turn in a second [rad/s^2].
constexpr double kTurnChange = 1;
/// This share of it remains when it stands: more cannot be told from noise.
constexpr double kStandingTurn = 0.02;
/// Before anything is known of it: speed [m/s], acceleration [m/s^2] and rate of turn [rad/s].
constexpr double kFastest = 20, kStrongest = 3, kStrongestTurn = 0.5;
/// How exactly the shifts tell the speed [m/s].
constexpr double kShiftSpeedDeviation = 3;
/// Measurements farther from the expected place are outliers [standard deviations]; they count
/// this many times less.
constexpr double kGate = 4, kOutlierFactor = 100;
/// An object has surely moved by what it moved less so many standard deviations.
constexpr double kSureDeviations = 2;
/// Above this speed an object's motion tells its heading [m/s]; a person's at half of it.
constexpr double kMinHeadingSpeed = 1.5;
/// How exactly the motion tells the heading of a vehicle [rad]. Of a car seen from behind only, the
/// surface says little of it: without this it turns further with each sweep.
constexpr double kMotionHeading = 0.1;
/// A vehicle of which more comes into view seems to go so much faster or slower [m/s].
constexpr double kCreep = 1;
/// No road is steeper [rad]: 20 degrees.
constexpr double kSteepest = 0.35;

// --- Registration of the surfaces of a track ---

/// Partners are looked for within these distances, step by step [m].
constexpr float kRegistrationRadii[] = {0.6f, 0.6f, 0.4f, 0.3f, 0.3f};
/// Where the object moved by more than this between neighbouring measurements [m], normals are
/// fitted to the samples within a radius [m], and to the nearest ones until they are so many, up to
/// this share of the object's horizontal diagonal away: samples of what is long are farther apart.
/// Normals are unknown where samples are spread across their plane by more than this share of how
/// they are spread in it, squared.
constexpr float kMaxBetweenNeighbors = 0.05f, kPlaneRadius = 0.5f;
constexpr std::size_t kMinPlaneSamples = 5;
constexpr float kPlaneShare = 0.11f, kMaxPlaneThickness = 0.1f;
/// Distance of samples from the plane of their partners [m]. It is that of noise and curvature,
/// times ten, since neighbouring samples err alike.
constexpr double kResidualDeviation = 0.2;
/// From the middle of a car to its ends [m], which a wrong heading displaces.
constexpr double kHalfLength = 2;
/// An object ends where its outermost edge is, if it is no farther inside than this [m].
constexpr float kEndMargin = 0.1f;
/// Seen from the side, the ends of an object are known this exactly [m]: its side is seen if this
/// share of its samples faces there.
constexpr double kEndDeviation = 0.1;
constexpr float kMinSideShare = 0.3f;
/// Ends that are farther apart or closer than they should by more than this are those of a piece
/// [m].
constexpr float kMaxLengthError = 0.5f;
/// Weight of the horizontal distance between partners, beside their distance across the surface.
constexpr double kPointWeight = 0.003, kLonePointWeight = 0.1;
/// How exactly a guess tells the position [m] and the heading [rad].
constexpr double kGuessDeviation = 0.3, kGuessHeadingDeviation = 0.05;
/// Where a surface tells nothing: position [m] and heading [rad].
constexpr double kUnknownPosition = 10, kUnknownHeading = 1;
/// Surfaces are known this exactly at best [m].
constexpr double kSurfaceDeviation = 0.02;
/// So many sweeps in a row err alike, as they see the same parts from nearly the same side:
/// together they tell the place no better than one of them.
constexpr double kSweepsAlike = 9;
/// Where a registration is farther than this from where the shifts lead, that place is tried,
/// too [m].
constexpr double kMaxDrift = 1;
/// A registration fails if a smaller share of the samples finds partners.
constexpr float kMinRegisteredShare = 0.5f;
/// After so many observations that lie beside the model a track goes on with something else.
constexpr std::size_t kMaxMisses = 3;
/// A model has at most so many voxels along the object.
constexpr float kModelVoxels = 40;
/// Part of an object is what so many sweeps saw,
constexpr int kMinHits = 3;
/// but for the outermost samples.
constexpr double kExtentQuantile = 0.99;

/// Smaller parts of a match than this share of the area of another one are its fragments.
constexpr float kFragmentShare = 0.25f;
/// A track is a part of a vehicle if it lies in it in this share of the sweeps that saw both, and
/// goes as fast but for this [m/s]: what few returns of a piece say of its speed.
constexpr float kPartShare = 0.8f, kPartSpeed = 3;
/// Nothing else stays in the outline of a vehicle, or so near to its side, while it goes so far
/// [m].
constexpr float kPartGap = 0.25f, kPartPath = 3;
/// No vehicle is wider [m]: 2.55 by law, its mirrors, and noise. So many directions are tried.
constexpr float kMaxVehicleWidth = 3.2f;
constexpr int kWidthDirections = 18;
/// What is told apart is remembered if this share of the track lies on what is kept.
constexpr float kMinKeptShare = 0.5f;
/// What touches a track but is none of it is kept as at most this many samples.
constexpr std::size_t kMaxNeighborSamples = 300;
/// Two parts belong together if their shares that are passing differ by less than this factor.
constexpr float kTogetherShare = 0.35f;
/// Of fewer points that should be passing, a share says nothing.
constexpr float kMinExpectedPoints = 5;
/// An object that is never seen to move stands where for so long [s] this share of it was free, in
/// the mean.
constexpr double kFreeWindow = 2;
constexpr float kMeanFreeShare = 0.4f;
/// A vehicle is at least this wide from any side, and this high [m].
constexpr float kMinVehicleWidth = 0.5f, kMinVehicleHeight = 0.6f;
/// Nothing that drives is higher [m], trams included. What is higher sways in the wind, unless it
/// goes farther than it is long.
constexpr float kMaxVehicleHeight = 5;
/// Longer than a motorcycle with its rider [m].
constexpr float kMinRailLength = 2.5f;
/// Crash barriers are no higher [m].
constexpr float kMaxRailHeight = 1.2f;
/// A place belongs to another vehicle if this share of an object would lie in its box: in a queue
/// they stand where others stood.
constexpr float kQueueShare = 0.25f;
/// Longer than any van [m]: where its rear stands its front was long before.
constexpr float kMinLongVehicle = 8;
/// An object that is less far from where it was stands at the same place [m].
constexpr float kSamePlace = 0.5f;

// --- Dynamic voxels ---

/// Edge of a voxel [m].
constexpr float kDynamicVoxelSize = 1.0f;
/// A dynamic voxel has at least this many dynamic samples,
constexpr int kMinDynamicSamples = 3;
/// and they are more than this share of its samples.
constexpr float kMinDynamicSampleShare = 0.6f;

// --- Time ---

/// Stamps may be off by this without changing which sweeps lie within a window [s].
constexpr double kTimeTolerance = 1e-3;

}  // namespace docdepth
