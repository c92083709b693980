#pragma once

#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "recording/message.h"
#include "storage/commit.h"

namespace soundmap::storage {

// What a made-up robot sends as its frame `offset`, and the evidence and state that a made-up
// pipeline gets from it: functions of the offset alone, so that a test knows what must be there
// after a crash.
recording::Message FrameAt(std::int64_t offset);
JournalEntry EntryAt(std::int64_t offset);
StateSnapshot StateAt(std::int64_t offset);

// End points on the walls of a room around (32768, 32768, 32768) as seen from a place in it, one a
// direction, in the order of a lattice of equal areas; three likelihoods.
std::vector<sound_map::EndPoint> RoomEndPoints(int directions, std::mt19937_64* random);

// Makes an empty folder under the tests' temporary folder, which goes when the program ends, and
// returns its path.
std::string EmptyFolder(const std::string& name);

// The same in memory where the system has /dev/shm (it may be small): for a test that opens
// thousands of logs, each of which syncs.
std::string EmptyMemoryFolder(const std::string& name);

std::string ReadWholeFile(const std::string& path);
void WriteWholeFile(const std::string& path, const std::string& bytes);

// Paths of the files below `folder` whose names end so, in order.
std::vector<std::string> FilesUnder(const std::string& folder, const std::string& suffix);

}  // namespace soundmap::storage
