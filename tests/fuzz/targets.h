// The targets of fuzzing: every reader of text or files that a user hands to a program, and rollouts of scenes.
//
// A target takes any bytes. It must come back, in time and without a leak, and checks on the way what must hold of what
// was read. scripts/fuzz.sh feeds the targets by libFuzzer, corpus_test.cc feeds them what is kept in corpus/<name>/.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "saltus/scene/scene.h"

namespace saltus::fuzz {

void ReadsScene(std::string_view bytes);     // a scene file
void ReadsSweep(std::string_view bytes);     // --sweep
void ReadsPoints(std::string_view bytes);    // the file of --sweep=@file
void ReadsGiven(std::string_view bytes);     // the file of --given
void ReadsSequence(std::string_view bytes);  // --sequence
void ReadsNpy(std::string_view bytes);       // an array as in the members of an NPZ file
void ReadsNpz(std::string_view bytes);       // an NPZ file
void RunsExtremes(std::string_view bytes);   // a scene file with extreme numbers, made from the bytes, and its rollouts

struct Target {
  const char* name;
  void (*run)(std::string_view bytes);
};
// Returns the targets of the program: the readers, or rollouts of scenes.
std::span<const Target> Targets();

// The scene that texts refer to: four discs, one fixed and two pushed, and a plane; some names have hyphens and dots.
const Scene& ExampleScene();

// The path of a file in memory with these contents, until the next call.
std::string FileWith(std::string_view bytes);

}  // namespace saltus::fuzz
