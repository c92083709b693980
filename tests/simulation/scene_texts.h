#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "sources/simulation/scene.h"

namespace soundmap::simulation {

// A small valid scene: free field, one white source, an array of one microphone on a robot that
// stands at (3, 3).
nlohmann::json StandingScene();

// The scene, which must be valid.
Scene Parse(const nlohmann::json& scene);

// The error sentence of an invalid scene; empty if it is valid.
std::string ErrorOf(const std::string& text);

// A new empty folder of the running test.
std::string FreshFolder();

}  // namespace soundmap::simulation
