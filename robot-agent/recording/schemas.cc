#include "recording/schemas.h"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/descriptor.pb.h>

#include <set>

#include "foxglove/FrameTransforms.pb.h"
#include "foxglove/KeyValuePair.pb.h"
#include "foxglove/LaserScan.pb.h"
#include "foxglove/Odometry.pb.h"
#include "foxglove/PointCloud.pb.h"
#include "foxglove/PoseInFrame.pb.h"
#include "foxglove/RawAudio.pb.h"

namespace soundmap::recording {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FileDescriptor;

void AddFile(const FileDescriptor& file, std::set<const FileDescriptor*>& done,
             google::protobuf::FileDescriptorSet& set) {
  if (!done.insert(&file).second) return;
  for (int i = 0; i < file.dependency_count(); ++i) AddFile(*file.dependency(i), done, set);
  file.CopyTo(set.add_file());
}

}  // namespace

std::optional<std::string> DescriptorSetOf(std::string_view schema) {
  for (const Descriptor* message :
       {foxglove::FrameTransforms::descriptor(), foxglove::KeyValuePair::descriptor(),
        foxglove::LaserScan::descriptor(), foxglove::Odometry::descriptor(),
        foxglove::PointCloud::descriptor(), foxglove::PoseInFrame::descriptor(),
        foxglove::RawAudio::descriptor()}) {
    if (message->full_name() != schema) continue;
    google::protobuf::FileDescriptorSet set;
    std::set<const FileDescriptor*> done;
    AddFile(*message->file(), done, set);
    return set.SerializeAsString();
  }
  return std::nullopt;
}

}  // namespace soundmap::recording
