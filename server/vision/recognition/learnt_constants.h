// What recognition has learnt from data: value, data set, commit, and the command whose answers it
// is fitted to. The fits are logistic regressions.
#pragma once

namespace horopter {

// The support and sharpness that chance gives a placement: what exceeds it speaks for the object.
// Chosen as the offset of both regressions below; an object with less is not accepted
// (PlacementAcceptance::min_score).
inline constexpr double kChanceSupport = 0.55;

// Whether a scene is no chance fit. Scenes of parts-train with all their parts enrolled against the
// same scenes with none of them, catalogs of 20; commit d8af989;
// `recognition_report parts-train train --trials all,none --accept-all --csv FILE`,
// `fit_decision.py scene FILE`.
inline constexpr double kScenePriorLogOdds = -7.5;     // the cameras adapt to the first object
inline constexpr double kSceneSupportWeight = 20.0;    // of an object's support above chance
inline constexpr double kSceneSharpnessWeight = 9.0;   // of its sharpness above chance
inline constexpr double kLearntCatalogObjects = 20.0;  // objects in the catalogs of that fit

// Whether one object is right in cameras that are. 368 answered objects of parts-train and of 18
// scenes of other parts, 16 of them wrong, mostly with one of the scene's parts left out of the
// catalog; commit 7b5f2c2; `recognition_report parts-train train --trials all,one --accept-all
// --csv FILE`, `fit_decision.py object FILE`.
inline constexpr double kObjectPriorLogOdds = 0.9;
inline constexpr double kObjectSupportWeight = 9.3;
inline constexpr double kObjectSharpnessWeight = 11.0;

// Set by hand on the photographs of tests/bench/history/photographs.md, commit b88011c
// (`recognition_report REAL SPLIT`): 40 - 62 patches alike and few unlike on right printed parts,
// at most 34 with 24 unlike on wrong ones.
inline constexpr double kTextureWeight = 1.6;  // of the texture for an object among the log odds
// Texture shows that faces lie about where the part has them, in cameras that may have adapted;
// that it is this part its edges must say. Less sharp than by chance by this much: it says nothing
// more.
inline constexpr double kBluntness = 0.1;

// Set by hand on the same photographs, commit 62a80e8: 0.8 - 1.0 of the patches are alike on right
// faces, 0.04 - 0.65 on wrong ones.
inline constexpr double kPatchesPerLogOdds = 8.0;  // it takes to change the log odds by one
inline constexpr double kUnlikePatchWeight = 2.0;  // of an unlike patch against a like one
inline constexpr double kMostTextureFor = 5.0;     // log odds
// ... and against: what hides a right part may be no catalog part.
inline constexpr double kMostTextureAgainst = 1.5;

// What is answered has passed more tests than the one its probability is fitted to. Of 34 answered
// objects of cad-dev, parts-dev and sets G1 - G3, H, K, L with probabilities of .60 - .97 all were
// right (within 10 px), of 268 with more 262, the others turned; ADR 55.
inline constexpr double kAnsweredLogOdds = 2.0;

}  // namespace horopter
