// What KinegraphClip.cs uses of Unity 2022 and glTFast 6, by their manuals: declarations alone, so that a C# compiler can
// check the script where there is no Unity.
using System.Threading.Tasks;

namespace UnityEngine
{
    public class Object { }
    public class Component : Object
    {
        public Transform transform => null;
        public T GetComponentInChildren<T>() => default(T);
    }
    public class Transform : Component { }
    public class MonoBehaviour : Component { }
    public class AnimationClip : Object { public string name => ""; }
    public class Animation : Component { public bool Play(string animation) => true; }
    [System.AttributeUsage(System.AttributeTargets.Field)]
    public class TextAreaAttribute : System.Attribute { }
    [System.AttributeUsage(System.AttributeTargets.Field)]
    public class TooltipAttribute : System.Attribute { public TooltipAttribute(string tooltip) { } }
    public static class JsonUtility { public static string ToJson(object obj) => ""; }
    public static class Debug { public static void LogError(object message) { } }
}

namespace UnityEngine.Networking
{
    public class UploadHandler { }
    public class UploadHandlerRaw : UploadHandler { public UploadHandlerRaw(byte[] data) { } }
    public class DownloadHandler { public byte[] data => null; public string text => ""; }
    public class DownloadHandlerBuffer : DownloadHandler { }
    public class UnityWebRequestAsyncOperation { }
    public class UnityWebRequest : System.IDisposable
    {
        public enum Result { InProgress, Success, ConnectionError, ProtocolError, DataProcessingError }
        public UnityWebRequest(string url, string method) { }
        public UploadHandler uploadHandler { get; set; }
        public DownloadHandler downloadHandler { get; set; }
        public Result result => Result.Success;
        public string error => "";
        public void SetRequestHeader(string name, string value) { }
        public UnityWebRequestAsyncOperation SendWebRequest() => null;
        public void Dispose() { }
    }
}

namespace GLTFast
{
    public enum AnimationMethod { None, Legacy, Mecanim }
    public class ImportSettings { public AnimationMethod AnimationMethod { get; set; } }
    public class GltfImport
    {
        public Task<bool> LoadGltfBinary(byte[] bytes, System.Uri uri = null, ImportSettings importSettings = null) => null;
        public Task<bool> InstantiateMainSceneAsync(UnityEngine.Transform parent) => null;
        public UnityEngine.AnimationClip[] GetAnimationClips() => null;
    }
}
